"""The load that inverse dynamics gives a suspended robot's motors is the one they had."""

from dataclasses import replace

import numpy as np
import pytest
from motor_logs import joints_of, log_of

from motorprior.exceptions import LogError
from motorprior.logs.loads import with_loads
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.world import World


def moved(
    torque_amplitude: float, seconds: float = 0.4, step: float = 2e-4
) -> tuple[MotorLog, np.ndarray]:
    """Known torques on a suspended robot without motors, finely simulated."""
    import mujoco

    world = World(PUPPER_V2, physics_dt=step, suspended=True)
    world.model.jnt_limited[:] = 0  # an end stop is no load of the motor's
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
        torque[row] = (
            torque_amplitude * np.sin(2 * np.pi * frequency * time[row] + phase) - 0.02 * vel[row]
        )
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


def test_inertia_times_acceleration_is_torque_plus_load():
    log, torque = moved(0.05)
    loaded = with_loads(log, PUPPER_V2)
    assert (
        loaded.load_inertia is not None
        and loaded.external_torque is not None
        and log.joint_vel is not None
    )
    acceleration = np.gradient(log.joint_vel, log.time, axis=0)
    balance = loaded.load_inertia * acceleration - loaded.external_torque - torque
    inside = slice(5, -5)
    assert np.abs(balance[inside]).max() < 0.02 * np.abs(loaded.load_inertia * acceleration).max()


def test_stiffness_is_what_gravity_gains_by_each_joint_s_own_angle():
    log = swaying(PUPPER_V2.nominal_pose, 0.0, rows=2)
    stiffness = with_loads(log, PUPPER_V2).load_stiffness
    tip = 1e-4
    assert stiffness is not None
    for joint in range(log.num_joints):
        ahead, behind = (
            swaying(PUPPER_V2.nominal_pose + way * tip * np.eye(12)[joint], 0.0, 2)
            for way in (1.0, -1.0)
        )
        torque = [with_loads(each, PUPPER_V2).external_torque[0, joint] for each in (ahead, behind)]  # pyright: ignore[reportOptionalSubscript]
        assert stiffness[0, joint] == pytest.approx(
            (torque[0] - torque[1]) / (2 * tip), rel=1e-4, abs=1e-7
        )
    assert np.abs(stiffness[0]).min() > 1e-3


def test_a_body_that_leans_is_refused_and_one_that_sways_is_not():
    log, _ = moved(0.0, 0.01)
    sway = 0.1 * np.sin(np.linspace(0.0, 20.0, log.num_rows))[:, None]
    with_loads(replace(log, base_orientation=np.array([0.02, -0.02]) + sway), PUPPER_V2)
    with pytest.raises(LogError, match=r"pitch is 0\.(2.|19) rad off level.*suspend the robot"):
        with_loads(replace(log, base_orientation=np.array([0.0, -0.2]) + sway), PUPPER_V2)
