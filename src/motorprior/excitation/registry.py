"""Find an excitation by its name or file. To add one, see `hand_made.EXCITATIONS`."""

from motorprior.exceptions import ConfigError
from motorprior.excitation.excitation import StreamSource
from motorprior.excitation.hand_made import EXCITATIONS as EXCITATIONS
from motorprior.excitation.learned_excitation import LearnedExcitation


def excitation_of(name: str, further_names: tuple[str, ...] = ()) -> StreamSource:
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
