"""The simulated body of a virtual robot."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import Fleet
from motorprior.hardware.virtual.firmware import Drive, SensorReadings
from motorprior.robots.robot import Robot
from motorprior.simulation.simulated_robot import SimulatedRobot

TWIN_STREAM = 0x7710  # separates the motors of virtual robots from those of benches, training and transfer studies


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> MotorParameters:
    """The motors of virtual robot number ``seed``, sampled independently; its firmware sets their gains.

    Raises:
        ConfigError: a fleet that is not of the geared family.
    """
    return require_geared(fleet.sample(robot.num_joints, np.random.default_rng([TWIN_STREAM, seed])))


class TwinBody:
    """`hardware.virtual.firmware.RobotBody` on `simulation.simulated_robot.SimulatedRobot`, in the robot's signs.

    Attributes:
        simulated: the simulated robot.
    """

    def __init__(self, robot: Robot, motors: MotorParameters, suspended: bool, seed: int):
        self._signs = robot.require_wire().joint_signs
        self.simulated = SimulatedRobot(robot, motors, suspended, np.random.default_rng([TWIN_STREAM, seed, 1]))
        self._drive: Drive | None = None
        self._gains: tuple[float, ...] = ()

    def advance(self, milliseconds: int, drive: Drive) -> None:
        """See `RobotBody.advance`."""
        gains = (*drive.kp, *drive.kd, drive.max_current)
        if gains != self._gains:
            self.simulated.set_gains(drive.kp, drive.kd, drive.max_current)
        self._drive, self._gains = drive, gains
        self.simulated.advance(milliseconds, self._signs * drive.target)

    def sense(self) -> SensorReadings:
        """See `RobotBody.sense`; the current is that of the control law at the present target."""
        state = self.simulated.state()
        pos, vel = self._signs * state.joint_pos, self._signs * state.joint_vel
        current = np.zeros_like(pos) if self._drive is None else self._drive.current(pos, vel)
        return SensorReadings(pos, vel, current, state.attitude, state.rates)
