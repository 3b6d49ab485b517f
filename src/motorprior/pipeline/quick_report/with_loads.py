"""Quick report of logs whose loads are known: PDs and a quickly fitted prior in free runs over other stretches."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import Fleet
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog, stated_gains_of
from motorprior.pipeline.adapt import motor_constants
from motorprior.pipeline.identify import PRIOR, fit_prior
from motorprior.pipeline.motor_choice import described_pd
from motorprior.pipeline.progress import Progress, WarningCollector
from motorprior.pipeline.quick_report.findings import Errors, Findings, constant_results, free_run_trace
from motorprior.pipeline.quick_report.fleet_comparison import (
    beside_each_other,
    beside_the_fleet,
    fleet_results,
    not_shown_results,
    shown_by_logs,
)
from motorprior.pipeline.recipe import recipe_of
from motorprior.pipeline.validation.log_baselines import with_gains_of
from motorprior.pipeline.validation.log_stretches import Split
from motorprior.report.real_motor_tables import FREE_RUN, RMSE
from motorprior.results import Results
from motorprior.robots.robot import Robot

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.latents.outliers import Outliers
    from motorprior.identification.presets import Preset

PRESET = "quick"
SHOWN = {
    "kp": "N·m/rad", "kd_over_kp": "s", "delay": "s", "armature": "kg·m²", "coulomb": "N·m", "viscous_damping":
    "N·m·s/rad", "backlash": "rad",
}  # fmt: skip
"""Constants that the user is told of, with their units."""
TOLD = frozenset({"kp", "kd_over_kp"})
"""Of them those that nobody has to find where a log states gains."""
POOR = 0.7
"""Share of a tuned PD's error from which on the user is warned of the fit."""
NO_LIMIT = 1e9
"""Torque limit of a PD of which none is known [N·m]."""
ODD = 0.05
"""p-value of all motors together from which on one is said to stand out."""


def report_with_loads(
    logs: Split, robot: Robot | None, fleet: Fleet | None, seed: int, folder: Path, progress: Progress
) -> Findings:
    """Fit to the known stretches, judge by the others.

    Args:
        logs: with loads, on the prior's grid, of joints that moved.
        robot: that the logs are of, if there is a description of it.
        fleet: population whose constants stand beside those of these motors, if they have one.
        seed: of the fit.
        folder: for the prior.
        progress: where to report to.

    Raises:
        LogError: too short, or without a channel that the fit needs.
    """
    from motorprior.identification.baselines.pd_fit import TUNING, tuned_pd
    from motorprior.identification.baselines.replay_error import scaled_gains, with_scaled_gains
    from motorprior.identification.evaluation.log_fidelity import whole_runs

    known = joined(list(logs.known.values()))
    heard = WarningCollector(progress)
    prior = fit_prior(known, PRESET, seed, out=folder, progress=heard)
    with progress.start("tune one PD", TUNING) as task:
        tuned = with_scaled_gains(tuned_pd(known, task.advance, scaled_gains(known)), known)
    preset = recipe_of(prior, folder / PRIOR)
    whole, seconds, traces = {}, {}, ()
    for name, log in logs.judged.items():
        models = {"tuned_pd": tuned, **_pd(log, robot), **_priors(prior, log)}
        whole[name], seconds[name] = _errors(log, with_gains_of(preset, log), models)
    errors, short = (Errors.of(logs.judged, found) for found in (whole, seconds))
    for place in dict.fromkeys((errors.typical("prior"), errors.worst("prior"))):
        log = logs.judged[errors.logs[place[0]]]
        models = {"tuned_pd": tuned, "prior": _priors(prior, log)["prior"]}
        runs = whole_runs(log, with_gains_of(preset, log), log.source)
        traces += (free_run_trace(errors.logs[place[0]], known.joint_names[place[1]], place[1], runs, models),)
    names = SHOWN.keys() - (TOLD if prior.network.gain_unit else ())
    constants = {name: value for name, value in motor_constants(prior, known, prior.mean).items() if name in names}
    shown = shown_by_logs(constants, _identifiable(prior, known, preset, constants))
    lines = (
        errors.compared(),
        *heard.warnings,
        *_advice(prior),
        *_told(prior, constants, shown, fleet, known.joint_names),
        errors.unlike("prior"),
    )
    rows = errors.rows(RMSE) + short.rows(FREE_RUN) + constant_results(shown, SHOWN, known.joint_names)
    rows += not_shown_results(constants, shown, SHOWN)
    rows += Results() if fleet is None else fleet_results(fleet, shown, SHOWN)
    return Findings(lines, rows, traces)


def _pd(log: MotorLog, robot: Robot | None) -> dict[str, LogModel]:
    """The PD that the log states or, if it states none, the robot's description; nothing if neither does."""
    described = None if robot is None else described_pd(robot)
    joints = [] if robot is None else [robot.joint_names.index(name) for name in log.joint_names]
    limit = np.full(log.num_joints, NO_LIMIT) if described is None else described.torque_limit[joints]
    nothing = np.zeros(log.num_joints)
    if log.stated_kd is not None and log.gain_unit == PHYSICAL_GAINS and (gains := stated_gains_of(log)) is not None:
        return {"ideal_pd": IdealPd(gains[0], gains[1], limit, nothing, nothing)}
    if described is None or log.stated_kp is not None:
        return {}
    return {"ideal_pd": IdealPd(described.kp[joints], described.kd[joints], limit, nothing, nothing)}


def _priors(prior: MotorPrior, log: MotorLog) -> dict[str, LogModel]:
    expected = prior.expected(log.joint_names)
    of_all = {} if log.num_joints == 1 else {"prior_mean": LatentActuator(prior.network, np.zeros_like(expected))}
    return {"prior": LatentActuator(prior.network, expected), **of_all}


def _errors(
    log: MotorLog, preset: Preset, models: dict[str, LogModel]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(J,) of free runs of whole segments, and of a second, by model [rad]."""
    from motorprior.identification.evaluation.log_fidelity import free_run_errors, free_runs, whole_runs, within_a_turn

    both = whole_runs(log, preset, log.source), [free_runs(log, preset, log.source)]
    found = (free_run_errors(runs, models) for runs in both)
    whole, short = ({name: np.asarray(within_a_turn(value)) for name, value in each.items()} for each in found)
    return whole, short


def _advice(prior: MotorPrior) -> list[str]:
    """A line where the fit leaves more than POOR of a tuned PD's error in the very log that it was fitted to."""
    if prior.metrics["unexplained"] < POOR:
        return []
    return [
        "the quick fit lacks physics, or its search was stuck: `motorprior identify` also tries the terms of a servo's "
        "firmware"
    ]


def _identifiable(prior: MotorPrior, known: MotorLog, preset: Preset, names: Iterable[str]) -> frozenset[str]:
    """Those of the constants that the training log identifies."""
    from motorprior.identification.physics.identifiability import identifiable_constants
    from motorprior.identification.physics.window_runs import WindowRuns
    from motorprior.identification.training_data.windows import training_data

    preset = with_gains_of(preset, known)
    runs = WindowRuns(training_data(known, preset, known.source), preset)
    return identifiable_constants(prior.network, runs, prior.mean, names)


def _told(
    prior: MotorPrior,
    constants: dict[str, np.ndarray],
    shown: dict[str, np.ndarray],
    fleet: Fleet | None,
    joints: tuple[str, ...],
) -> list[str]:
    """How the motors differ from each other and from a fleet of theirs."""
    from motorprior.identification.latents.outliers import leave_one_out_outliers

    odd, lines = leave_one_out_outliers(prior), []
    if constants:
        lines.append(beside_each_other(constants, shown, SHOWN))
    if odd is not None:
        lines.append(_stands_out(odd, joints))
    if fleet is not None and shown:
        lines.append(beside_the_fleet(fleet, shown, SHOWN))
    return lines


def _stands_out(odd: Outliers, joints: tuple[str, ...]) -> str:
    first = int(odd.p_value.argmin())
    p_value = min(1.0, len(joints) * float(odd.p_value[first]))
    said = f"{joints[first]}: its {odd.latent[first]} is {odd.deviation[first]:+.1f} deviations from the others'"
    if p_value < ODD:
        return f"one motor stands out among yours: {said} (p {p_value:.2g})"
    return f"no motor stands out among yours; farthest is {said} (p {p_value:.2g})"
