"""What a prior is compared with on real logs: models that are fitted to the same logs with equal care."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.identify import fit_prior
from motorprior.pipeline.progress import SILENT, Progress

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.log_fidelity import LogModel
    from motorprior.identification.presets import Preset

PRESETS = {"per_motor": "per_motor", "pooled_network": "one_network"}
"""Baselines that are recipes of identification: every motor's physics by itself, and one network for all motors."""


@dataclass(frozen=True)
class BaselineFits:
    """How the baselines are fitted.

    Attributes:
        folder: for those that take minutes, which are kept there.
        adam_steps: of the pooled network; the preset's own number if not given.
        seed: of searches and weights.
    """

    folder: Path
    adam_steps: int | None = None
    seed: int = 0


def fitted_responses(log: MotorLog, preset: Preset, seed: int = 0, progress: Progress = SILENT) -> dict[str, LogModel]:
    """pure_delay, second_order and servo_limits, which need no load: gravity is the joint's angle in a log without.

    Raises:
        LogError: another sample period, or no segment that is long enough.
    """
    from motorprior.identification.log_fidelity import whole_runs
    from motorprior.identification.response_fit import fit_responses

    runs, gravity = whole_runs(with_some_load(log), preset, log.source), "torque"
    if log.external_torque is None:
        gravity = "angle"
    with progress.start("fit responses that need no load", log.num_joints) as task:
        return dict(fit_responses(runs, gravity, seed, task.advance))


def with_some_load(log: MotorLog) -> MotorLog:
    """The log, with a load that response models do not read if it has none."""
    if log.external_torque is not None and log.load_inertia is not None:
        return log
    shape = log.joint_pos.shape
    return replace(log, external_torque=np.zeros(shape), load_inertia=np.ones(shape))


def fitted_baselines(
    log: MotorLog, preset: Preset, fits: BaselineFits, progress: Progress = SILENT
) -> dict[str, LogModel]:
    """All baselines, fitted to a log with known loads; they are of its motors, in its order.

    Args:
        log: what is known.
        preset: recipe of the prior: sample period and warm-up.
        fits: how.
        progress: where to report to.

    Raises:
        LogError: it lacks a channel, has another sample period, or is too short.
    """
    from motorprior.identification.baselines import TUNING, tuned_pd

    models = fitted_responses(log, preset, fits.seed, progress)
    for name, recipe in PRESETS.items():
        steps = fits.adam_steps if name == "pooled_network" else None
        known = fit_prior(log, recipe, fits.seed, steps=steps, out=fits.folder / name, progress=progress)
        models[name] = LatentActuator(known.network, known.mean)
    with progress.start("tune one PD", TUNING) as task:
        models["tuned_pd"] = tuned_pd(log, task.advance)
    return models
