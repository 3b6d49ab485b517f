"""Loads by inverse dynamics equal the loads that a simulated suspended robot had."""

from dataclasses import replace

import numpy as np
import pytest
from motor_logs import joints_of, log_of

from motorprior.exceptions import LogError
from motorprior.logs.loads import with_loads
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.world import World


def log_and_torques(
    torque_amplitude: float,
    seconds: float = 0.4,
    step: float = 2e-4,
    gravity: np.ndarray | None = None,
) -> tuple[MotorLog, np.ndarray]:
    """Log and torques (N, 12) [N·m] of a suspended robot without motors, finely simulated.

    ``gravity`` (3,) is in the frame of the base [m/s²].
    """
    import mujoco

    world = World(PUPPER_V2, physics_dt=step, suspended=True)
    world.model.jnt_limited[:] = 0  # the torque of an end stop is no load of the motor
    if gravity is not None:
        world.model.opt.gravity[:] = gravity
    world.data.qpos[:] = PUPPER_V2.nominal_pose
    rng = np.random.default_rng(0)
    frequency = rng.uniform(1.0, 4.0, 12)
    phase = rng.uniform(0.0, 6.0, 12)
    rows = round(seconds / step)
    time = np.arange(rows) * step
    pos = np.zeros((rows, 12))
    vel = np.zeros((rows, 12))
    torque = np.zeros((rows, 12))

    for row in range(rows):
        pos[row] = world.data.qpos
        vel[row] = world.data.qvel
        drive = torque_amplitude * np.sin(2 * np.pi * frequency * time[row] + phase)
        torque[row] = drive - 0.02 * vel[row]
        world.data.qfrc_applied[:] = torque[row]
        mujoco.mj_step(world.model, world.data)  # pyright: ignore[reportAttributeAccessIssue]

    return log_of(time, pos, joint_vel=vel, **joints_of(PUPPER_V2)), torque


def swaying(pose: np.ndarray, amplitude: float = 0.01, rows: int = 400) -> MotorLog:
    """All joints sway about a pose, once a second."""
    time = 0.002 * np.arange(rows)
    phase = 2 * np.pi * time[:, None] + np.arange(12)
    pos = pose + amplitude * np.sin(phase)
    vel = 2 * np.pi * amplitude * np.cos(phase)

    return log_of(time, pos + 0.1 * np.sin(phase), pos, joint_vel=vel, **joints_of(PUPPER_V2))


def largest_imbalance(log: MotorLog, torque: np.ndarray) -> float:
    """Largest inertia·acceleration - load - torque, over the largest inertia·acceleration [-]."""
    loaded = with_loads(log, PUPPER_V2)
    assert loaded.load_inertia is not None
    assert loaded.external_torque is not None
    assert log.joint_vel is not None

    acceleration = np.gradient(log.joint_vel, log.time, axis=0)
    balance = loaded.load_inertia * acceleration - loaded.external_torque - torque
    inside = slice(5, -5)
    return np.abs(balance[inside]).max() / np.abs(loaded.load_inertia * acceleration).max()


def test_inertia_times_acceleration_is_torque_plus_load():
    assert largest_imbalance(*log_and_torques(0.05)) < 0.02


def test_loads_of_a_tilted_base_have_its_gravity():
    roll = 0.3
    pitch = -0.5
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    )
    about_y = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    base_to_world = about_y @ about_x
    log, torque = log_and_torques(0.05, gravity=base_to_world.T @ np.array([0.0, 0.0, -9.81]))
    tilted = replace(log, base_orientation=np.tile([roll, pitch], (log.num_rows, 1)))

    assert largest_imbalance(tilted, torque) < 0.02
    assert largest_imbalance(log, torque) > 0.1, "the tilt counts"


def test_load_stiffness_is_the_derivative_of_the_load_by_the_angle_of_its_joint():
    log = swaying(PUPPER_V2.nominal_pose, 0.0, rows=2)
    stiffness = with_loads(log, PUPPER_V2).load_stiffness
    tip = 1e-4  # [rad]
    assert stiffness is not None

    for joint in range(log.num_joints):
        step = tip * np.eye(12)[joint]
        ahead = with_loads(swaying(PUPPER_V2.nominal_pose + step, 0.0, 2), PUPPER_V2)
        behind = with_loads(swaying(PUPPER_V2.nominal_pose - step, 0.0, 2), PUPPER_V2)
        assert ahead.external_torque is not None
        assert behind.external_torque is not None
        change = ahead.external_torque[0, joint] - behind.external_torque[0, joint]
        assert stiffness[0, joint] == pytest.approx(change / (2 * tip), rel=1e-4, abs=1e-7)

    assert np.abs(stiffness[0]).min() > 1e-3


def test_loads_of_a_base_that_sways_are_refused_and_of_one_that_leans_are_not():
    log, _ = log_and_torques(0.0, 0.01)
    sway = np.sin(np.linspace(0.0, 20.0, log.num_rows))[:, None]
    with_loads(replace(log, base_orientation=np.array([0.02, -0.5]) + 0.1 * sway), PUPPER_V2)

    with pytest.raises(LogError, match=r"roll .*0\.(2.|19) rad"):
        with_loads(replace(log, base_orientation=np.array([0.0, -0.2]) + 0.2 * sway), PUPPER_V2)
