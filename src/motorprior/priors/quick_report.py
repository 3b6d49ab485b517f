"""Quick report of models fitted to the training rows of logs: PDs and a prior if loads are known, else responses."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from motorprior.actuator.constants import Constants
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd, described_pd
from motorprior.evaluation.errors import FREE_RUN_RMSE, WHOLE_RUN_RMSE
from motorprior.evaluation.free_runs import (
    FREE_RUN,
    WHOLE_RUN,
    MotorModel,
    Validation,
    free_runs,
    validation_of,
)
from motorprior.evaluation.splits import Split
from motorprior.exceptions import listed
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.baselines.response_fit import (
    RESPONSE_CONSTANTS,
    at_bounds,
    fitted_responses,
)
from motorprior.identification.physics.window_runs import whole_runs
from motorprior.identification.presets import identification_preset, recipe_of
from motorprior.logs.loads import with_placeholder_load
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog
from motorprior.logs.operations import joined
from motorprior.priors.fit_prior import fit_recipe
from motorprior.progress import Note, Progress
from motorprior.robots.robot import Robot

PRESET = "quick"
# constant of servo_limits, factor to its unit, and unit
REPORTED = {
    "delay": ("delay", 1.0, "s"),
    "bandwidth": ("rate", 0.5 / np.pi, "Hz"),
    "dead_band": ("band", 1.0, "rad"),
    "gain": ("gain", 1.0, "1"),
    "offset": ("offset", 1.0, "rad"),
    "speed_limit": ("speed", 1.0, "rad/s"),
    "acceleration_limit": ("acceleration", 1.0, "rad/s²"),
}


def report_with_loads(
    logs: Split, robot: Robot | None, seed: int, folder: Path, progress: Progress
) -> Validation:
    """Fit a prior, in ``folder``, and a PD to logs with loads, and evaluate them on the test rows."""
    train = joined(list(logs.train.values()))
    warnings: list[str] = []
    tuned = fitted_tuned_pd(train, progress)

    def keep_warning(note: Note) -> None:
        if note.severity == "warning":
            warnings.append(note.text)
        progress.report(note)

    kept = Progress(keep_warning, progress.line)
    prior = fit_recipe(
        train, PRESET, identification_preset(PRESET), seed, folder, kept, tuned=tuned
    )
    models = {
        "tuned_pd": tuned,
        **_ideal_pd(train, robot),
        "prior": prior.model.motors(prior.predicted(train).mean),
    }
    if train.num_joints > 1:
        models["prior_mean"] = prior.model.motors(
            prior.classes.mean_and_std(prior.joint_classes(train))[0]
        )
    runs = {name: free_runs(log, recipe_of(prior)) for name, log in logs.test.items()}
    spans = {FREE_RUN_RMSE: FREE_RUN, WHOLE_RUN_RMSE: WHOLE_RUN}
    of_spans = {
        quantity: {name: runs[name][span] for name in runs} for quantity, span in spans.items()
    }
    found = validation_of(logs.test, of_spans, models, "prior", ("tuned_pd", "prior"))
    warnings += found.warnings
    return replace(found, warnings=warnings, constants=prior.constants())


def report_without_loads(logs: Split, seed: int, progress: Progress) -> Validation:
    """Fit responses, which need no load, and evaluate them on the test rows; arguments as `report_with_loads`."""
    preset = identification_preset("rollout")
    train = joined(list(logs.train.values()))
    models = fitted_responses(train, preset, seed, progress)
    runs = {name: whole_runs(with_placeholder_load(log), preset) for name, log in logs.test.items()}
    found = validation_of(
        logs.test, {WHOLE_RUN_RMSE: runs}, models, "servo_limits", ("second_order", "servo_limits")
    )
    responses = models["servo_limits"]
    fitted = dict(zip(RESPONSE_CONSTANTS, responses.constants.T, strict=True))
    bounds = at_bounds(responses)
    values = {}
    units = {}
    identified = {}
    warnings = []
    for name, (key, factor, unit) in REPORTED.items():
        # a part that no joint needs
        if np.allclose(fitted[key], RESPONSE_CONSTANTS[key], atol=1e-6):
            continue
        at_bound = bounds.get(key, np.zeros(train.num_joints, bool))  # an offset has no bounds
        values[name] = factor * fitted[key]
        units[name] = unit
        identified[name] = not at_bound.any()
        joints = [
            f"{train.joint_names[i]} {values[name][i]:.3g} {unit}" for i in np.flatnonzero(at_bound)
        ]
        warnings += [
            f"{name} at a bound of the search, so not identifiable: {listed(joints, 6)}"
        ] * bool(joints)
    return replace(found, warnings=warnings, constants=Constants.of(values, units, identified))


def _ideal_pd(log: MotorLog, robot: Robot | None) -> dict[str, MotorModel]:
    """A PD with the logged gains or, without any, those of the robot; none if neither has gains in N·m/rad."""
    described = None if robot is None else described_pd(robot)
    joints = [] if robot is None else [robot.joint_names.index(name) for name in log.joint_names]
    limit = np.full(log.num_joints, 1e9) if described is None else described.torque_limit[joints]
    zero = np.zeros(log.num_joints)
    one = np.ones(log.num_joints)
    if log.logged_kd is not None and log.gain_unit == PHYSICAL_GAINS:
        return {"ideal_pd": GainScaledPd(IdealPd(one, one, limit, zero, zero), np.ones(2))}
    if described is None or log.logged_kp is not None:
        return {}
    return {"ideal_pd": IdealPd(described.kp[joints], described.kd[joints], limit, zero, zero)}
