"""joint_torque against a known load."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog

STEPS, DT, INERTIA = 2000, 0.002, 0.004


@pytest.fixture
def log() -> MotorLog:
    """A joint that swings as its torque and its load say."""
    time = DT * np.arange(STEPS)
    pos = 0.3 * np.sin(2 * np.pi * 2.0 * time)
    vel, acceleration = np.gradient(pos, DT), -((2 * np.pi * 2.0) ** 2) * pos
    external = 0.2 * np.sin(time)
    column = lambda values: np.asarray(values)[:, None]  # noqa: E731
    return MotorLog(
        time=time, position_target=column(pos), joint_pos=column(pos), joint_vel=column(vel),
        joint_torque=column(INERTIA * acceleration - external), load_inertia=np.full((STEPS, 1), INERTIA),
        external_torque=column(external), joint_names=("knee",), robot="bench", motor="m", source="made",
    )  # fmt: skip


def test_a_torque_that_moved_its_load_is_not_mentioned(log: MotorLog):
    assert check_log(log).of("load") == ()


def test_a_torque_of_the_wrong_sign_is(log: MotorLog):
    (finding,) = check_log(replace(log, joint_torque=-np.asarray(log.joint_torque))).of("load")
    assert finding.severity == "warning" and finding.value < -0.9 and finding.joint == "knee"


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_torque_in_another_unit_is(log: MotorLog, factor: float):
    (finding,) = check_log(replace(log, joint_torque=factor * np.asarray(log.joint_torque))).of("load")
    assert finding.value == pytest.approx(1.0 / factor, rel=0.05)


def test_a_log_without_loads_says_nothing(log: MotorLog):
    assert check_log(replace(log, load_inertia=None, external_torque=None)).of("load") == ()
