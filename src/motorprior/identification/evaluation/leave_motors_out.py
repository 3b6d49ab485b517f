"""A prior on unseen motors: fitted to the other motors of a robot, and tested on those left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.adapt import adapt_to
from motorprior.identification.baselines.log_baselines import baseline_recipes, with_gains_of
from motorprior.identification.evaluation.model_errors import model_errors
from motorprior.identification.fit_prior import PRIOR, fit_prior, fit_recipe
from motorprior.identification.prior_file import recipe_of
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.splits import first_and_rest
from motorprior.progress import SILENT, Progress
from motorprior.robots.robot import Robot

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel

PER_MOTOR = "per_motor"


@dataclass(frozen=True)
class MotorsOut:
    """Errors of the motors that were left out, in free runs of the test rows.

    Attributes:
        joints: J names.
        errors: (J,) root mean square errors [rad] by model: ``prior``, the central motor of the others; ``same_place``,
            the mean of the others at the same place of their legs, if the robot has legs; ``adapted``, the prior
            adapted to the first seconds; ``per_motor``, the physics of each motor fitted to them alone, if the prior
            has the period of `log_baselines`; and ``tuned_pd``, one PD tuned on the others.
        coverage: level [%] -> share of the recorded angles in the bands of the adapted prior.
    """

    joints: tuple[str, ...]
    errors: dict[str, np.ndarray]
    coverage: dict[int, float]


def motor_groups(robot: Robot) -> list[list[int]]:
    """Joints to leave out together: those of each leg, or each joint of a robot without legs."""
    if robot.legs:
        return [list(leg.joints) for leg in robot.legs]
    return [[joint] for joint in range(robot.num_joints)]


def leave_motors_out(
    train: MotorLog,
    test: MotorLog,
    robot: Robot,
    group: Sequence[int],
    preset: str,
    seconds: float,
    out: Path,
    seed: int = 0,
    progress: Progress = SILENT,
) -> MotorsOut:
    """Fit a prior to the other motors in ``train``; test it on the group's motors in ``test``.

    Args:
        train: log with loads; of it the motors of the group are not used.
        test: log with loads.
        robot: of both logs.
        group: indices of the joints that are left out.
        preset: recipe of the prior.
        seconds: of ``test`` that ``adapted`` and ``per_motor`` use [s]; the remaining rows are the test.
        out: folder of the two fits.
        seed: of the fits.
        progress: where to report to.

    Raises:
        ConfigError: an unknown preset, or a test log that is not longer than the seconds.
        LogError: a log that is too short, or lacks a channel.
    """
    from motorprior.identification.baselines.pd_fit import repeated, tuned_pd
    from motorprior.identification.baselines.replay_error import scaled_gains, with_scaled_gains
    from motorprior.identification.evaluation.log_fidelity import log_coverage, whole_runs
    from motorprior.identification.presets import identification_preset

    others = train.with_joints([joint for joint in range(train.num_joints) if joint not in group])
    of_group = test.with_joints(group)
    first, rest = first_and_rest(of_group, seconds)
    alone = baseline_recipes(first, identification_preset(preset), {PER_MOTOR}).get(PER_MOTOR)
    prior, path = fit_prior(others, preset, seed, out=out / "others", progress=progress), out / "others" / PRIOR
    models: dict[str, LogModel] = {}
    if alone is not None:
        fitted = fit_recipe(first, *alone, seed, out / PER_MOTOR, progress)
        models[PER_MOTOR] = LatentActuator(fitted.network, fitted.mean)
    found = adapt_to(prior, path, first, first.source)
    pd = repeated(tuned_pd(others, at_gains=scaled_gains(others)), len(group))
    models |= {
        "prior": LatentActuator(prior.network, prior.expected(of_group.joint_names)),
        "adapted": LatentActuator(prior.network, found.mean),
        "tuned_pd": with_scaled_gains(pd, others),
    }
    if robot.legs:
        models["same_place"] = LatentActuator(prior.network, _same_place(prior, robot, group))
    runs = whole_runs(rest, with_gains_of(recipe_of(prior, path), rest), rest.source)
    return MotorsOut(of_group.joint_names, model_errors(runs, models), log_coverage(prior, found, runs))


def _same_place(prior: MotorPrior, robot: Robot, group: Sequence[int]) -> np.ndarray:
    """(J, Z) the mean of the prior's motors at the same place of a leg as each joint of the group, or 0."""
    latents = np.zeros((len(group), prior.network.num_latents))
    rows = dict(zip(prior.joint_names, prior.mean, strict=False))  # motors of a bench have no names
    for row, joint in enumerate(group):
        place = next((leg.joints.index(joint) for leg in robot.legs if joint in leg.joints), None)
        names = [] if place is None else [robot.joint_names[leg.joints[place]] for leg in robot.legs]
        if alike := [rows[name] for name in names if name in rows]:
            latents[row] = np.mean(alike, axis=0)
    return latents
