"""A calibration recovers the motors of logs, and reports constants that are not identifiable."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_robot import record_log

from motorprior.actuator.distribution import Distribution
from motorprior.actuator.families import FAMILIES
from motorprior.actuator.fleet import Fleet
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.calibration import (
    FleetProblem,
    Parameter,
    calibrate,
    calibrated_fleet,
    single_motors,
)
from motorprior.studies.log_replay import Replayer, with_posture

TRUE = {"kp": 7.6, "kd_over_kp": 0.088, "coulomb": 0.19}


def actuator_of(fleet: Fleet, **values: np.ndarray):
    """Central motors of the fleet, with these (joints,) values of constants."""
    constants = {}
    for name, distribution in fleet.parameters.items():
        constants[name] = np.full(ROBOT.num_joints, distribution.center)
    return FAMILIES[fleet.family].motors(constants | values).actuator()


def problem_of(fleet: Fleet, actuator, logs: int) -> FleetProblem:
    """Calibration of the fleet with this number of recorded logs of a suspended robot."""
    replayers = {}
    for seed in range(logs):
        log = with_posture(record_log(actuator, suspended=True, seed=seed), "suspended")
        replayers[f"log_{seed}"] = Replayer(log, ROBOT)
    return FleetProblem(fleet, ROBOT, replayers)


def with_uncertain(fleet: Fleet, *names: str) -> Fleet:
    """The fleet with only these constants uncertain."""
    parameters = {}
    for name, distribution in fleet.parameters.items():
        if name in names:
            parameters[name] = distribution
        else:
            parameters[name] = Distribution("constant", {"center": distribution.center})
    return replace(fleet, parameters=parameters)


def test_the_centre_of_two_logs_is_recovered(fleet):
    true = {name: np.full(ROBOT.num_joints, value) for name, value in TRUE.items()}
    problem = problem_of(with_uncertain(fleet, *TRUE), actuator_of(fleet, **true), logs=2)

    calibration = calibrate(problem, starts=2, iterations=5, seed=0)

    center = {}
    for parameter, x in zip(problem.parameters, calibration.center, strict=True):
        center[parameter.name] = parameter.value(x)
    assert center["kp"] == pytest.approx(TRUE["kp"], rel=0.01)
    assert center["kd_over_kp"] == pytest.approx(TRUE["kd_over_kp"], rel=0.01)
    assert center["coulomb"] == pytest.approx(TRUE["coulomb"], rel=0.08)
    assert all(map(Parameter.is_identifiable, problem.parameters, calibration.error))
    assert problem.rmse("log_0", calibration.left_out["log_0"][0]) < 1e-3

    fitted = calibrated_fleet(problem, calibration)
    assert fitted.parameters["kp"].center == pytest.approx(center["kp"], rel=1e-3)
    assert fitted.parameters["delay"] == problem.fleet.parameters["delay"]
    spread = fitted.parameters["kp"].values["spread"]
    assert spread < fleet.parameters["kp"].values["spread"], "all motors are alike"


def test_a_constant_that_is_not_identifiable_keeps_its_prior(fleet):
    """The constant is the armature, in a slow motion with noise."""
    log = with_posture(record_log(actuator_of(fleet), speed=0.1), "suspended")
    noise = 0.005 * np.random.default_rng(0).standard_normal(log.joint_pos.shape)
    log = replace(log, joint_pos=log.joint_pos + noise)
    replayers = {"log": Replayer(log, ROBOT)}
    problem = FleetProblem(with_uncertain(fleet, "kd_over_kp", "armature"), ROBOT, replayers)

    calibration = calibrate(problem, starts=1, iterations=3, seed=0)

    assert calibration.left_out == {}
    is_identifiable = {}
    for parameter, error in zip(problem.parameters, calibration.error, strict=True):
        is_identifiable[parameter.name] = parameter.is_identifiable(error)
    assert is_identifiable == {"kd_over_kp": True, "armature": False}
    prior_mean = problem.mean[1]
    assert calibration.center[1] == pytest.approx(prior_mean, abs=0.5 * problem.prior_std[1])


def test_offsets_of_single_motors_are_recovered(fleet):
    kp = np.full(ROBOT.num_joints, fleet.parameters["kp"].center)
    strong = ROBOT.legs[0].joints[2]
    weak = ROBOT.legs[3].joints[1]
    kp[strong] *= 1.3
    kp[weak] *= 0.75
    problem = problem_of(with_uncertain(fleet, "kp"), actuator_of(fleet, kp=kp), logs=2)
    problem = problem.with_residual_deviation(problem.mean)
    center = problem.mean
    centers = dict.fromkeys(problem.replayers, center)

    offset_of_joints, spread, left_out = single_motors(problem, center, centers)

    offsets = dict(zip(problem.joints, offset_of_joints, strict=True))
    assert offsets.pop(strong) > 0.15
    assert offsets.pop(weak) < -0.15
    assert max(abs(offset) for offset in offsets.values()) < 0.07
    assert spread["kp"] >= fleet.parameters["kp"].values["spread"]
    assert problem.rmse("log_0", center, left_out["log_0"]) < problem.rmse("log_0", center)
