"""What a prior says of motors that it never saw: fitted to the other motors of a robot, judged on those left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import adapt_to, first_and_rest
from motorprior.pipeline.identify import PRIOR, fit_prior, fit_recipe
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.recipe import recipe_of
from motorprior.pipeline.validation.log_baselines import baseline_recipes, with_gains_of
from motorprior.pipeline.validation.log_stretches import with_joints
from motorprior.robots.robot import Robot

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel

PER_MOTOR = "per_motor"


@dataclass(frozen=True)
class MotorsOut:
    """Errors of the motors that were left out, in free runs of what follows the seconds that were told.

    Attributes:
        joints: their names.
        errors: (J,) root mean square errors [rad] by model: ``prior``, the central motor of the others, told nothing
            but stated gains; ``same_place``, the mean of the others at the same place of their legs, if there are any;
            ``adapted``, the prior adapted to the seconds told; ``per_motor``, the physics of each motor fitted to them
            alone, over windows as long as the prior's, if the prior has the period of `log_baselines`; and
            ``tuned_pd``, one PD tuned on the others.
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
    known: MotorLog,
    judged: MotorLog,
    robot: Robot,
    group: Sequence[int],
    preset: str,
    seconds: float,
    out: Path,
    seed: int = 0,
    progress: Progress = SILENT,
) -> MotorsOut:
    """Fit a prior to the other motors of ``known``; judge it on the group's motors in ``judged``.

    Args:
        known: log with loads; of it the motors of the group are not used.
        judged: log with loads.
        robot: that both are of.
        group: indices of the joints that are left out.
        preset: recipe of the prior.
        seconds: of ``judged`` that ``adapted`` and ``per_motor`` know [s]; the rest is judged.
        out: folder of the two fits.
        seed: of them.
        progress: where to report to.

    Raises:
        ConfigError: an unknown preset, or a judged log that is no longer than the seconds.
        LogError: a log that is too short, or lacks a channel.
    """
    from motorprior.identification.baselines.pd_fit import repeated, tuned_pd
    from motorprior.identification.baselines.replay_error import scaled_gains, with_scaled_gains
    from motorprior.identification.evaluation.log_fidelity import (
        free_run_errors,
        log_coverage,
        whole_runs,
        within_a_turn,
    )
    from motorprior.identification.presets import identification_preset

    others = [joint for joint in range(known.num_joints) if joint not in group]
    left, of_group = with_joints(known, others), with_joints(judged, group)
    told, rest = first_and_rest(of_group, seconds)
    alone = baseline_recipes(told, identification_preset(preset), {PER_MOTOR}).get(PER_MOTOR)
    prior = fit_prior(left, preset, seed, out=out / "others", progress=progress)
    models: dict[str, LogModel] = {}
    if alone is not None:
        fitted = fit_recipe(told, *alone, seed, out / PER_MOTOR, progress)
        models[PER_MOTOR] = LatentActuator(fitted.network, fitted.mean)
    found = adapt_to(prior, out / "others" / PRIOR, told, told.source)
    models |= {
        "prior": LatentActuator(prior.network, prior.expected(of_group.joint_names)),
        "adapted": LatentActuator(prior.network, found.mean),
        "tuned_pd": with_scaled_gains(repeated(tuned_pd(left, at_gains=scaled_gains(left)), len(group)), left),
    }
    if robot.legs:
        models["same_place"] = LatentActuator(prior.network, _same_place(prior, robot, group))
    runs = whole_runs(rest, with_gains_of(recipe_of(prior, out / "others" / PRIOR), rest), rest.source)
    errors = {name: np.asarray(within_a_turn(value)) for name, value in free_run_errors(runs, models).items()}
    return MotorsOut(of_group.joint_names, errors, log_coverage(prior, found, runs))


def _same_place(prior: MotorPrior, robot: Robot, group: Sequence[int]) -> np.ndarray:
    """(J, Z) of every joint of the group the mean of the prior's motors at its place of a leg, or 0."""
    latents = np.zeros((len(group), prior.network.num_latents))
    rows = dict(zip(prior.joint_names, prior.mean, strict=False))  # a bench's have no names
    for row, joint in enumerate(group):
        place = next((leg.joints.index(joint) for leg in robot.legs if joint in leg.joints), None)
        names = [] if place is None else [robot.joint_names[leg.joints[place]] for leg in robot.legs]
        if alike := [rows[name] for name in names if name in rows]:
            latents[row] = np.mean(alike, axis=0)
    return latents
