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


def test_loads_without_velocities_are_judged_by_clean_angles(log: MotorLog):
    bare = replace(log, joint_vel=None)
    assert check_log(bare).of("load") == () and check_log(bare).of("torque_sign") == ()
    torque = np.asarray(log.joint_torque)
    (finding,) = check_log(replace(bare, joint_torque=2.0 * torque)).of("load")
    assert finding.value == pytest.approx(0.5, rel=0.02)
    (finding,) = check_log(replace(bare, joint_torque=-torque)).of("load")
    assert finding.value < -0.9
    short = np.repeat([0, 1], [STEPS - 10, 10])  # a last segment that is too short to tell its noise
    (finding,) = check_log(replace(bare, joint_torque=2.0 * torque, segment=short)).of("load")
    assert finding.value == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize(("coulomb", "viscous"), [(2.0, 0.0), (0.0, 0.1), (1.0, 0.05)])
def test_friction_of_a_gear_in_a_torque_from_a_current_is_no_fault(
    log: MotorLog, velocity: bool, coulomb: float, viscous: float
):
    """Up to seven times what the load needs."""
    speed = np.asarray(log.joint_vel)
    friction = coulomb * np.tanh(speed / 0.05) + viscous * speed
    log = replace(
        log, joint_torque=np.asarray(log.joint_torque) + friction, joint_vel=log.joint_vel if velocity else None
    )
    assert check_log(log).of("load") == ()
    for factor in (3.0, -1.0):
        assert check_log(replace(log, joint_torque=factor * np.asarray(log.joint_torque))).of("load")
