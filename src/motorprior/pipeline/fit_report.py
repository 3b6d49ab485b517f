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
        quality = fit_quality(motors, log, task.advance, of_the_log, recipe.usual_conditions)
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
    from motorprior.identification.physics.term_selection import least_difference

    found = []
    for name, least, usual, most in recipe.conditions:
        (term, unit), values = _TERM_OF[name], getattr(log, name)
        if values is None:
            if term in terms:
                found.append(f"note: the log states no {name}: taken as the prior's usual one, {usual:.3g} {unit}")
            continue
        means = np.array([values[part].mean(axis=0) for part in log.segment_slices()])
        beyond = least_difference(name, usual)
        if means.min() < least - beyond or means.max() > most + beyond:
            effect = "is extrapolated" if term in terms else "is not known: what is found holds under these alone"
            found.append(
                f"warning: {name} is {_range(means.min(), means.max())} {unit}, in the prior's logs "
                f"{_range(least, most)} {unit}; what such a difference does {effect} -> check its unit, or identify "
                "with logs of both"
            )
    return found


def _range(least: float, most: float) -> str:
    one, other = f"{least:.3g}", f"{most:.3g}"
    return one if one == other else f"{one} to {other}"
