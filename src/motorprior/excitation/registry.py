"""All excitations by name. To add one, add an entry to EXCITATIONS."""

from functools import partial

from motorprior.exceptions import ConfigError
from motorprior.excitation.excitation import Excitation
from motorprior.excitation.hand_made import (
    chirp,
    gait,
    held_steps,
    impacts,
    multisine,
    ramps,
    sine,
)
from motorprior.excitation.learned_excitation import LearnedExcitation

EXCITATIONS = {
    "sine": Excitation(sine),
    "steps": Excitation(held_steps, jumps=True),
    "gait": Excitation(gait),
    "impacts": Excitation(gait, impacts),
    # Slow motion [rad], dominated by friction and backlash.
    # The external torque [N·m] reaches from stiction to stall.
    "creep": Excitation(partial(ramps, reach=0.3), partial(ramps, reach=2.0)),
    "chirp": Excitation(chirp),
    "multisine": Excitation(multisine),
}


def excitation_of(name: str, further_names: tuple[str, ...] = ()) -> Excitation | LearnedExcitation:
    """The excitation of this name, or in this file (.safetensors).

    Raises:
        ConfigError: unknown name; the remedy also lists ``further_names``.
        ArtifactError: see `LearnedExcitation.load`.
    """
    if name.endswith(".safetensors"):
        return LearnedExcitation.load(name)

    if name not in EXCITATIONS:
        names = ", ".join((*EXCITATIONS, *further_names))
        raise ConfigError(
            f"no excitation {name!r}",
            remedy=f"use one of {names}, or a file that `motorprior excite` wrote",
            argument="excitation",
        )
    return EXCITATIONS[name]
