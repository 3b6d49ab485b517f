"""What a user is told of how well motors replay their log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.identification.presets import Preset
from motorprior.logs.doctor.joint_checks import joints_at_rest
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.progress import Progress

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.judging.fit_quality import FitQuality

_TERM_OF = {"supply_voltage": ("supply", "V"), "motor_temperature": ("temperature", "°C")}
"""Of each condition the term that says what it does, and the unit."""


def told_quality(
    motors: LatentActuator, log: MotorLog, recipe: Preset, progress: Progress, of_the_log: bool = True
) -> FitQuality:
    """Errors of the motors of a log beside those of a tuned PD, and what they mean; each line is a note.

    ``recipe`` is the motors', and ``of_the_log`` tells whether they were fitted to it.
    """
    from motorprior.identification.baselines.tuned_pds import TUNING
    from motorprior.identification.judging.fit_quality import fit_quality

    with progress.start("tune a PD to compare with", TUNING) as task:
        quality = fit_quality(motors, log, task.advance, of_the_log, dict(recipe.conditions))
    for line in quality.lines():
        progress.note(line)
    return quality


def told_at_rest(log: MotorLog) -> str:
    """A line about joints that hardly move, of which nothing can be learned; "" where all do."""
    resting = joints_at_rest(log)
    if not resting:
        return ""
    return (
        f"warning: did not move: {', '.join(resting)}; what is said of such motors is a guess "
        "-> leave such joints out, or record them in motion"
    )


def other_conditions(terms: tuple[str, ...], recipe: Preset, log: MotorLog) -> list[str]:
    """Lines about conditions of a log of which motors with these terms, learned by this recipe, do not know enough."""
    from motorprior.identification.physics.term_selection import VARIES
    from motorprior.identification.training_data.windows import relative_conditions

    usual, found = dict(recipe.conditions), []
    here = np.median([relative_conditions(part, usual) for part in log.segments()], axis=(0, 2))
    for (name, (term, unit)), value, neutral in zip(_TERM_OF.items(), here.tolist(), (1.0, 0.0), strict=True):
        if name not in usual:
            continue
        if (stated := getattr(log, name)) is None and term in terms:
            found.append(f"note: the log states no {name}: taken as the prior's, {usual[name]:.3g} {unit}")
        elif stated is not None and term not in terms and abs(value - neutral) > VARIES[term][1]:
            found.append(
                f"warning: {name} is {np.median(stated):.3g} {unit}, in the prior's logs {usual[name]:.3g} {unit}, and "
                "the prior does not know what another one does: what is found of these motors holds at this one "
                "-> identify with logs of several"
            )
    return found
