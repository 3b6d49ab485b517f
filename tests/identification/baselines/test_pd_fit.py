"""The PD that made a log is recovered, and scales with the gains of other logs."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record, training_motors
from motorprior.identification.baselines.pd_fit import (
    TUNING,
    WITH_FRICTION,
    fit_pd,
    pd_motors,
    starting_points,
    tuned_pd,
)
from motorprior.identification.baselines.replay_error import closed_loop_error, scaled_gains, trials, with_scaled_gains
from motorprior.identification.evaluation.errors import free_run_errors, whole_runs
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog

TRUE = {"kp": 7.0, "kd": 0.7, "torque_limit": 1.2, "armature": 0.004, "delay": 0.004, "coulomb": 0.15}
START = {"kp": 8.8, "kd": 0.84, "torque_limit": 1.26}
LAGS = {"armature": (0.003,), "delay": (0.003,)}
MOTORS = 2


@pytest.fixture(scope="module")
def bench() -> MotorLog:
    fleet = load_fleet("pupper_v2")
    return record(training_motors(fleet, MOTORS, 0), bench_preset("rollout"), 5000, 0, fleet)


def made_by(bench: MotorLog, motors: Actuator) -> MotorLog:
    """The same commands and loads with the motion of these motors."""
    return replace(bench, joint_pos=np.concatenate([run(motors, trial).joint_pos for trial, _ in trials(bench)]))


def test_the_pd_with_friction_that_made_the_log_is_found(bench: MotorLog):
    counts = []
    log = made_by(bench, pd_motors(TRUE, MOTORS))
    fit = fit_pd(log, starting_points(START, WITH_FRICTION, LAGS), WITH_FRICTION, counts.append)
    assert fit.converged and fit.error < 1e-3 and sum(counts) == fit.evaluations
    for name, value in TRUE.items():
        assert fit.constants[name] == pytest.approx(value, rel=0.05), name


def test_a_pd_with_delay_armature_and_limit_is_found_without_a_starting_point(bench: MotorLog):
    true, counts = IdealPd.uniform(MOTORS, 12.0, 0.6, 1.4, 0.018, 0.04), []
    log = made_by(bench, true)
    found = tuned_pd(log, counts.append)
    assert closed_loop_error(log)(found) < 2e-3 and len(counts) <= TUNING
    for name in ("kp", "kd", "torque_limit", "delay"):
        assert getattr(found, name)[0] == pytest.approx(getattr(true, name)[0], rel=0.15, abs=1e-3), name


def test_a_pd_is_scaled_to_the_gains_of_each_segment(bench: MotorLog):
    first = np.arange(bench.num_rows) < bench.segment_slices()[1].stop
    scale = np.where(first, 1.0, 2.0)[:, None] * np.ones(MOTORS)
    pd = IdealPd.uniform(MOTORS, 8.0, 0.5, 5.0)
    fitted = replace(bench, stated_kp=np.full_like(scale, 20.0), stated_kd=np.ones_like(scale))
    other = replace(bench, stated_kp=20.0 * scale, stated_kd=scale)
    at_gains = scaled_gains(fitted)
    cases = zip(trials(other), other.segments(), strict=True)
    made = [run(at_gains(pd, part), trial).joint_pos for (trial, _), part in cases]
    other = replace(other, joint_pos=np.concatenate(made), joint_vel=None)
    preset = replace(PRESETS["rollout"], warm_up=10)
    errors = free_run_errors(whole_runs(other, preset), {"scaled": with_scaled_gains(pd, fitted), "fixed": pd})
    assert np.all(errors["scaled"] < 0.2 * errors["fixed"])
    assert with_scaled_gains(pd, bench) is pd
