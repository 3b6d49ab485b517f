"""Quick report of models fitted to the training rows of logs: PDs and a prior if loads are known, else responses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd, described_pd
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.adapt import motor_constants
from motorprior.identification.baselines.log_baselines import (
    BaselineFits,
    fitted_responses,
    fitted_tuned_pd,
    with_gains_of,
)
from motorprior.identification.evaluation.log_tables import CONSTANT, FREE_RUN, UNIDENTIFIED, WHOLE_RUN, Trace
from motorprior.identification.evaluation.model_errors import LogErrors, free_run_spans, model_errors
from motorprior.identification.fit_prior import PRIOR, fit_prior
from motorprior.identification.prior_file import recipe_of
from motorprior.logs.loads import with_some_load
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog
from motorprior.logs.operations import joined
from motorprior.logs.splits import Split
from motorprior.progress import Progress, WarningCollector
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.physics.window_runs import WindowRuns

PRESET = "quick"
UNITS = {
    "kp": "N·m/rad", "kd_over_kp": "s", "delay": "s", "armature": "kg·m²", "coulomb": "N·m", "viscous_damping":
    "N·m·s/rad", "backlash": "rad",
}  # fmt: skip
# constant of servo_limits, factor and unit
RESPONSE_CONSTANTS = {
    "delay": ("delay", 1e3, "ms"), "bandwidth": ("rate", 0.5 / np.pi, "Hz"), "dead_band": ("band", 1e3, "mrad")
}  # fmt: skip
MIN_RATIO = 1.05  # a constant is identifiable if its maximum over its minimum over the motors exceeds this
OUTLIER_P_VALUE = 0.05  # p-value of the farthest motor, corrected for the number of motors


@dataclass(frozen=True)
class QuickReport:
    """Errors and constants, traces to draw, and warnings."""

    results: Results
    traces: tuple[Trace, ...]
    lines: tuple[str, ...] = ()


def report_with_loads(logs: Split, robot: Robot | None, seed: int, folder: Path, progress: Progress) -> QuickReport:
    """Fit a prior and a PD, and evaluate them on the test rows.

    Args:
        logs: with loads, on the prior's grid, of joints that moved.
        robot: of the logs, if there is a description of it.
        seed: of the fit.
        folder: for the prior.
        progress: where to report to.

    Raises:
        LogError: too short, or without a channel that the fit needs.
    """
    train = joined(list(logs.train.values()))
    collector = WarningCollector(progress)
    prior = fit_prior(train, PRESET, seed, out=folder, progress=collector)
    tuned = fitted_tuned_pd(train, progress)
    preset = recipe_of(prior, folder / PRIOR)
    runs = {name: free_run_spans(log, with_gains_of(preset, log)) for name, log in logs.test.items()}
    models = {
        name: {"tuned_pd": tuned, **_ideal_pd(log, robot), **_prior_models(prior, log)}
        for name, log in logs.test.items()
    }
    whole, short = (
        LogErrors.of(logs.test, {name: model_errors(runs[name][span], models[name]) for name in logs.test})
        for span in ("whole_run", "free_run")
    )
    traces = _traces(whole, "prior", {name: runs[name]["whole_run"] for name in runs}, models, ("tuned_pd", "prior"))
    names = UNITS.keys() - ({"kp", "kd_over_kp"} if prior.network.gain_unit else set())  # logged gains are not fitted
    constants = {name: values for name, values in motor_constants(prior, train, prior.mean).items() if name in names}
    identified = _identified(prior, train, constants)
    results = whole.results(WHOLE_RUN) + short.results(FREE_RUN)
    results += constant_results({name: constants[name] for name in identified}, UNITS, train.joint_names)
    results += Results.of(
        Result(f"{CONSTANT}{name}", UNITS[name], float(np.median(values)), statistic=UNIDENTIFIED)
        for name, values in constants.items()
        if name not in identified
    )
    lines = (*collector.warnings, *whole.warnings("prior"), *_outliers(prior, train.joint_names))
    return QuickReport(results, traces, tuple(line.removeprefix("warning: ") for line in lines))


def report_without_loads(logs: Split, seed: int, folder: Path, progress: Progress) -> QuickReport:
    """Fit responses, which need no load, and evaluate them on the test rows; arguments as `report_with_loads`."""
    from motorprior.identification.baselines.response_models import CONSTANTS
    from motorprior.identification.evaluation.log_fidelity import whole_runs
    from motorprior.identification.presets import identification_preset

    preset, train = identification_preset("rollout"), joined(list(logs.train.values()))
    models = fitted_responses(train, preset, BaselineFits(folder, seed=seed), progress)
    runs = {name: whole_runs(with_some_load(log), preset, log.source) for name, log in logs.test.items()}
    errors = LogErrors.of(logs.test, {name: model_errors(runs[name], models) for name in logs.test})
    traces = _traces(errors, "servo_limits", runs, dict.fromkeys(runs, models), ("second_order", "servo_limits"))
    fitted = dict(zip(CONSTANTS, models["servo_limits"].constants.T, strict=True))
    constants = {name: factor * fitted[key] for name, (key, factor, _) in RESPONSE_CONSTANTS.items()}
    units = {name: unit for name, (_, _, unit) in RESPONSE_CONSTANTS.items()}
    results = errors.results(WHOLE_RUN) + constant_results(constants, units, train.joint_names)
    return QuickReport(results, traces)


def _ideal_pd(log: MotorLog, robot: Robot | None) -> dict[str, LogModel]:
    """A PD with the logged gains or, without any, those of the robot; none if neither has gains in N·m/rad."""
    described = None if robot is None else described_pd(robot)
    joints = [] if robot is None else [robot.joint_names.index(name) for name in log.joint_names]
    limit = np.full(log.num_joints, 1e9) if described is None else described.torque_limit[joints]
    zero = np.zeros(log.num_joints)
    if log.stated_kd is not None and log.gain_unit == PHYSICAL_GAINS and (gains := log.gains) is not None:
        return {"ideal_pd": IdealPd(gains[0], gains[1], limit, zero, zero)}
    if described is None or log.stated_kp is not None:
        return {}
    return {"ideal_pd": IdealPd(described.kp[joints], described.kd[joints], limit, zero, zero)}


def _prior_models(prior: MotorPrior, log: MotorLog) -> dict[str, LogModel]:
    expected = prior.expected(log.joint_names)
    mean = {} if log.num_joints == 1 else {"prior_mean": LatentActuator(prior.network, np.zeros_like(expected))}
    return {"prior": LatentActuator(prior.network, expected), **mean}


def _traces(
    errors: LogErrors,
    model: str,
    runs: Mapping[str, Sequence[WindowRuns]],
    models: Mapping[str, Mapping[str, LogModel]],
    drawn: Collection[str],
) -> tuple[Trace, ...]:
    """Longest free runs of the joints with the model's median and maximum error."""
    from motorprior.identification.evaluation.log_fidelity import angle_errors
    from motorprior.identification.training_data.windows import POS, SECONDS, TARGET

    found = []
    for log, joint in errors.median_and_max(model):
        name = errors.logs[log]
        longest = max(runs[name], key=lambda run: run.preset.window)
        time, target, measured = (longest.recorded(channel)[joint, 0] for channel in (SECONDS, TARGET, POS))
        simulated = {key: measured + angle_errors(longest, models[name][key])[joint, 0] for key in drawn}
        found.append(Trace(name, errors.joints[joint], time, target, measured, simulated))
    return tuple(found)


def constant_results(values: Mapping[str, np.ndarray], units: Mapping[str, str], joints: Sequence[str]) -> Results:
    """A row per constant and joint."""
    return Results.of(
        Result(f"{CONSTANT}{name}", units[name], float(value), part=joint)
        for name, column in values.items()
        for joint, value in zip(joints, column, strict=True)
    )


def _identified(prior: MotorPrior, train: MotorLog, constants: Mapping[str, np.ndarray]) -> list[str]:
    """The constants that the training log identifies, or in which the motors differ."""
    from motorprior.identification.physics.identifiability import identifiable_constants
    from motorprior.identification.physics.window_runs import WindowRuns
    from motorprior.identification.training_data.windows import training_data

    preset = with_gains_of(recipe_of(prior, "the prior"), train)
    runs = WindowRuns(training_data(train, preset, train.source), preset)
    identifiable = identifiable_constants(prior.network, runs, prior.mean, constants)
    return [
        name
        for name, values in constants.items()
        if name in identifiable or np.max(values) / max(np.min(values), 1e-12) > MIN_RATIO
    ]


def _outliers(prior: MotorPrior, joints: tuple[str, ...]) -> list[str]:
    from motorprior.identification.latents.outliers import leave_one_out_outliers

    outliers = leave_one_out_outliers(prior)
    if outliers is None:
        return []
    first = int(outliers.p_value.argmin())
    p_value = min(1.0, len(joints) * float(outliers.p_value[first]))
    if p_value >= OUTLIER_P_VALUE:
        return []
    return [
        f"warning: {joints[first]} is an outlier: its {outliers.latent[first]} differs from the other motors' by "
        f"{outliers.deviation[first]:+.1f} standard deviations (p = {p_value:.2g})"
    ]
