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
    center = {
        name: np.full(ROBOT.num_joints, each.center) for name, each in fleet.parameters.items()
    }
    return FAMILIES[fleet.family].motors(center | values).actuator()


def problem_of(fleet: Fleet, actuator, logs: int) -> FleetProblem:
    found = {}
    for seed in range(logs):
        log = with_posture(record_log(actuator, suspended=True, seed=seed), "suspended")
        found[f"log_{seed}"] = Replayer(log, ROBOT)
    return FleetProblem(fleet, ROBOT, found)


def with_uncertain(fleet: Fleet, *names: str) -> Fleet:
    """The fleet with only these constants uncertain."""
    constants = {
        name: Distribution("constant", {"center": each.center})
        for name, each in fleet.parameters.items()
    }
    return replace(fleet, parameters=constants | {name: fleet.parameters[name] for name in names})


def test_the_centre_of_two_logs_is_recovered(fleet):
    true = {name: np.full(ROBOT.num_joints, value) for name, value in TRUE.items()}
    problem = problem_of(with_uncertain(fleet, *TRUE), actuator_of(fleet, **true), logs=2)
    found = calibrate(problem, starts=2, iterations=5, seed=0)
    center = {
        each.name: each.value(x) for each, x in zip(problem.parameters, found.center, strict=True)
    }
    assert center["kp"] == pytest.approx(TRUE["kp"], rel=0.01)
    assert center["kd_over_kp"] == pytest.approx(TRUE["kd_over_kp"], rel=0.01)
    assert center["coulomb"] == pytest.approx(TRUE["coulomb"], rel=0.08)
    assert all(map(Parameter.is_identifiable, problem.parameters, found.error))
    assert problem.rmse("log_0", found.left_out["log_0"][0]) < 1e-3
    fitted = calibrated_fleet(problem, found)
    assert fitted.parameters["kp"].center == pytest.approx(center["kp"], rel=1e-3)
    assert fitted.parameters["delay"] == problem.fleet.parameters["delay"]
    assert fitted.parameters["kp"].values["spread"] < fleet.parameters["kp"].values["spread"], (
        "all motors are alike"
    )


def test_a_constant_that_is_not_identifiable_keeps_its_prior(fleet):
    """Armature, in a slow motion with noise."""
    log = with_posture(record_log(actuator_of(fleet), speed=0.1), "suspended")
    noise = 0.005 * np.random.default_rng(0).standard_normal(log.joint_pos.shape)
    log = replace(log, joint_pos=log.joint_pos + noise)
    problem = FleetProblem(
        with_uncertain(fleet, "kd_over_kp", "armature"), ROBOT, {"log": Replayer(log, ROBOT)}
    )
    found = calibrate(problem, starts=1, iterations=3, seed=0)
    assert found.left_out == {}
    names = [each.name for each in problem.parameters]
    known = dict(
        zip(names, map(Parameter.is_identifiable, problem.parameters, found.error), strict=True)
    )
    assert known == {"kd_over_kp": True, "armature": False}
    assert found.center[1] == pytest.approx(problem.mean[1], abs=0.5 * problem.prior_std[1])


def test_offsets_of_single_motors_are_recovered(fleet):
    kp = np.full(ROBOT.num_joints, fleet.parameters["kp"].center)
    strong = ROBOT.legs[0].joints[2]
    weak = ROBOT.legs[3].joints[1]
    kp[strong], kp[weak] = 1.3 * kp[strong], 0.75 * kp[weak]
    problem = problem_of(with_uncertain(fleet, "kp"), actuator_of(fleet, kp=kp), logs=2)
    problem = problem.with_residual_deviation(problem.mean)
    center = problem.mean
    found, spread, left_out = single_motors(
        problem, center, dict.fromkeys(problem.replayers, center)
    )
    offsets = dict(zip(problem.joints, found, strict=True))
    assert offsets.pop(strong) > 0.15 and offsets.pop(weak) < -0.15
    assert max(map(abs, offsets.values())) < 0.07
    assert spread["kp"] >= fleet.parameters["kp"].values["spread"]
    assert problem.rmse("log_0", center, left_out["log_0"]) < problem.rmse("log_0", center)
