"""Fits of ideal PDs to logs of ideal PDs."""

from dataclasses import replace

import numpy as np
import pytest
from motor_logs import swinging_load

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.bench.dynamometer import run, trial_of
from motorprior.bench.recording import bench_schedule, record, training_motors
from motorprior.identification.baselines.pd_fit import (
    WITH_FRICTION,
    WITH_ROTOR,
    fit_pd,
    fitted_tuned_pd,
)
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined
from motorprior.progress import SILENT

MOTORS = 2
WITH_ALL = {
    "kp": 7.0,
    "kd": 0.7,
    "torque_limit": 1.2,
    "armature": 0.004,
    "delay": 0.004,
    "coulomb": 0.15,
}
SLOW = {"kp": 12.0, "kd": 0.6, "torque_limit": 1.4, "armature": 0.018, "delay": 0.04}


@pytest.fixture(scope="module")
def bench() -> MotorLog:
    fleet = load_fleet("pupper_v2")
    return record(training_motors(fleet, MOTORS, 0), bench_schedule("rollout"), 5000, 0, fleet)


def made_by(bench: MotorLog, motors: Actuator) -> MotorLog:
    """Log with the commands and loads of ``bench`` and the motion of these motors."""
    positions = [run(motors, trial_of(segment)).joint_pos for segment in bench.segments()]
    return replace(bench, joint_pos=np.concatenate(positions))


@pytest.mark.parametrize(
    ("true", "free"), [(WITH_ALL, WITH_FRICTION), (SLOW, WITH_ROTOR)], ids=["friction", "slow"]
)
def test_a_fit_recovers_the_pd_that_made_a_log(
    bench: MotorLog, true: dict[str, float], free: tuple[str, ...]
):
    fit = fit_pd(made_by(bench, IdealPd.uniform(MOTORS, **true)), free)
    assert fit.error < 2e-3
    for name in set(true) - {"armature"}:
        assert fit.constants[name] == pytest.approx(true[name], rel=0.1, abs=1e-3), name


def test_segments_without_position_control_do_not_count_in_the_gains_of_the_tuned_pd():
    gains = {"logged_kp": np.full((200, 1), 40.0), "logged_kd": np.full((200, 1), 2.0)}
    feedforward = np.zeros((200, 1))
    torque = swinging_load(200, command_mode="torque", torque_feedforward=feedforward)

    pd = fitted_tuned_pd(joined([swinging_load(200, **gains), torque, torque]), SILENT)

    assert isinstance(pd, GainScaledPd)
    np.testing.assert_array_equal(pd.logged, [40.0, 2.0])
