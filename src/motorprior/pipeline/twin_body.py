"""The twin as the body of a virtual robot: here simulation and hardware meet."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.families import geared
from motorprior.bench.fleet import Fleet
from motorprior.hardware.sign_conventions import servo_current
from motorprior.hardware.virtual.firmware import Drive, Sensors
from motorprior.robots.robot import Robot
from motorprior.simulation.simulated_robot import SimulatedRobot

TWIN_STREAM = 0x7710  # separates the motors of virtual robots from those of benches, training and transfer studies


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> MotorParameters:
    """The motors of virtual robot number ``seed``, sampled independently; its firmware sets their gains.

    Raises:
        ConfigError: a fleet of another family than the geared motors.
    """
    return geared(fleet.sample(robot.num_joints, np.random.default_rng([TWIN_STREAM, seed])))


class TwinBody:
    """`hardware.virtual.firmware.Body` on `simulation.simulated_robot.SimulatedRobot`, in the robot's signs.

    Attributes:
        live: the simulated robot.
    """

    def __init__(self, robot: Robot, motors: MotorParameters, suspended: bool, seed: int):
        self._signs = robot.require_wire().joint_signs
        self.live = SimulatedRobot(robot, motors, suspended, np.random.default_rng([TWIN_STREAM, seed, 1]))
        self._drive: Drive | None = None

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """See `Body.advance`."""
        last, self._drive = self._drive, drive
        if last is None or not _same_gains(drive, last):
            self.live.set_gains(drive.kp, drive.kd, drive.max_current)
        self.live.advance(milliseconds, self._signs * drive.target)

    def sense(self) -> Sensors:
        """See `Body.sense`; the current is that of the control law at the present target."""
        state = self.live.state()
        pos, vel = self._signs * state.joint_pos, self._signs * state.joint_vel
        current = np.zeros_like(pos)
        if (drive := self._drive) is not None:
            current = servo_current(drive.target, pos, vel, drive.kp, drive.kd, drive.max_current)
        return Sensors(pos, vel, current, state.attitude, state.rates)


def _same_gains(one: Drive, other: Drive) -> bool:
    same = np.array_equal(one.kp, other.kp) and np.array_equal(one.kd, other.kd)
    return same and one.max_current == other.max_current
