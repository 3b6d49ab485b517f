"""What a user is told of how well motors replay their log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from motorprior.actuator.latent import LatentActuator
from motorprior.identification.presets import Preset
from motorprior.logs.doctor.excitation import joints_at_rest
from motorprior.logs.motor_log import MotorLog, segment_means
from motorprior.logs.settings_text import range_text
from motorprior.pipeline.progress import Progress

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.evaluation.fit_quality import FitQuality


def told_quality(
    motors: LatentActuator, log: MotorLog, recipe: Preset, progress: Progress, of_the_log: bool = True
) -> FitQuality:
    """Errors of the motors of a log beside those of a tuned PD, and what they mean; each line is a note.

    ``recipe`` is the motors', and ``of_the_log`` tells whether they were fitted to it.
    """
    from motorprior.identification.baselines.pd_fit import TUNING
    from motorprior.identification.evaluation.fit_quality import fit_quality

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


def other_conditions(recipe: Preset, log: MotorLog) -> list[str]:
    """Lines about conditions of a log of which motors that were learned by this recipe do not know enough."""
    from motorprior.identification.physics.term_selection import TERM_OF, min_difference

    found = []
    for name, least, usual, most in recipe.conditions:
        known = TERM_OF[name] in recipe.terms
        if getattr(log, name) is None:
            if known:
                taken = range_text(name, usual, usual)
                found.append(f"note: the log states no {name}: taken as the prior's usual one, {taken}")
            continue
        means, beyond = segment_means(log, name), min_difference(name, usual)
        if means.min() < least - beyond or means.max() > most + beyond:
            effect = "is extrapolated" if known else "is not known: what is found holds under these alone"
            found.append(
                f"warning: {name} is {range_text(name, means.min(), means.max())}, in the prior's logs "
                f"{range_text(name, least, most)}; what such a difference does {effect} -> check its unit, or "
                "identify with logs of both"
            )
    return found
