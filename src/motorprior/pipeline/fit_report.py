"""What a user is told of how well motors replay their log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from motorprior.actuator.latent import LatentActuator
from motorprior.logs.doctor.joint_checks import joints_at_rest
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.progress import Progress

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.judging.fit_quality import FitQuality


def told_quality(motors: LatentActuator, log: MotorLog, progress: Progress, of_the_log: bool = True) -> FitQuality:
    """Errors of the motors of a log beside those of a tuned PD, and what they mean; each line is a note.

    ``of_the_log`` tells whether the motors were fitted to it.
    """
    from motorprior.identification.baselines.tuned_pds import TUNING
    from motorprior.identification.judging.fit_quality import fit_quality

    with progress.start("tune a PD to compare with", TUNING) as task:
        quality = fit_quality(motors, log, task.advance, of_the_log)
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
