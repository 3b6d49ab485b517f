"""Replay of the commands in a real robot's log on a simulated robot, to compare joint angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.exceptions import LogError
from motorprior.logs.joint_checks import excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.resampling import drop_repeats, resample
from motorprior.robots.robot import Robot
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World, WorldConfig

COMMAND_PERIOD = 0.002
"""Period of the grid on which commands are held [s]; the rows of the logs are 1.5-10 ms apart."""
_LEAD_IN = 1.0
"""Time before the first command [s], in which a free robot stands in its nominal pose and a fixed one holds its first
target, as the real robots did."""


@dataclass(frozen=True)
class LogReplay:
    """One log replayed on one set of motors.

    Attributes:
        joint_pos: (rows, joints) simulated angle [rad] at the times of the prepared log: that of the encoder on the
            rotor for physical motors and grey boxes, that of the joint for models without a rotor.
        rmse: (joints,) joint RMSE [rad], start included; NaN for joints that were not excited.
    """

    joint_pos: np.ndarray
    rmse: np.ndarray


def prepare(log: MotorLog, robot: Robot, where: str) -> MotorLog:
    """Drop repeated measurements; refuse a log of another robot.

    Raises:
        LogError: not the joints of this robot, or no joint was excited.
    """
    if log.joint_names != robot.joint_names:
        raise LogError(
            f"joints {list(log.joint_names)} are not those of {robot.name}",
            where=where,
            remedy=f"needs {robot.joint_names}",
        )
    if not excited_joints(log).size:
        raise LogError("no joint is excited", where=where, remedy="record with a moving command")
    return drop_repeats(log)


def replay_log(log: MotorLog, robot: Robot, actuator: Actuator, prepared: MotorLog) -> LogReplay:
    """Simulate the commands of ``log`` and compare with the measurements of ``prepared``.

    Simulated angles are limited to ±2π, so that the error stays finite if the simulation diverges.
    """
    physics_dt = robot.physics_step(actuator.kind.longest_step)
    world = World(WorldConfig.of(robot, physics_dt=physics_dt, control_dt=COMMAND_PERIOD))
    grid = resample(log, COMMAND_PERIOD)
    rest = robot.nominal_pose if robot.base == "free" else grid.position_target[0]
    lead_in = np.tile(rest, (round(_LEAD_IN / COMMAND_PERIOD), 1))
    recorded = replay(world, actuator, grid.position_target, rest, lead_in, tolerate_fault=True)
    measured = np.clip(np.nan_to_num(recorded.measured_joint_pos, nan=np.inf), -2 * np.pi, 2 * np.pi)
    simulated = np.stack([np.interp(prepared.time, grid.time, column) for column in measured.T], axis=1)
    error = np.sqrt(np.mean((simulated - prepared.joint_pos) ** 2, axis=0))
    excited = np.isin(np.arange(log.num_joints), excited_joints(log))
    return LogReplay(simulated, np.where(excited, error, np.nan))
