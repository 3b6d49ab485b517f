"""A virtual robot in this process, or in another process for the commands deploy, record and doctor."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Literal

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.bounds import require_seed
from motorprior.exceptions import MotorPriorError, RobotFault
from motorprior.hardware.settings import require_robot_extra
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.simulated_robot import SimulatedRobot

if TYPE_CHECKING:  # they import msgpack, which is an extra
    from motorprior.hardware.virtual.firmware import Drive, SensorReadings
    from motorprior.hardware.virtual.virtual_robot import VirtualRobot

TWIN_STREAM = 0x7710  # separates the motors of virtual robots from those of benches, training and transfer studies
_HOMING_TIME = 1.0  # [s], a little more than homing takes


@dataclass(frozen=True)
class VirtualRobotSettings:
    """A simulated robot behind the interface of a real one: pseudo-terminal and firmware, in real time."""

    fleet: str | None = None
    """Fleet of its motors; the robot's own if not given."""
    seed: int = 0
    """Number of the robot; every number has other motors."""
    suspended: bool = False
    """Suspended in the air instead of on the ground."""
    rate: Literal[100, 200] = 100
    """Telemetry frames per second."""
    currents: bool = False
    """The firmware sends motor currents."""
    homing: bool = True
    """Home at the start."""


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> MotorParameters:
    """The motors of virtual robot number ``seed``, sampled independently; its firmware sets their gains.

    Raises:
        ConfigError: a fleet that is not of the geared family.
    """
    return require_geared(fleet.sample(robot.num_joints, np.random.default_rng([TWIN_STREAM, seed])))


class TwinBody:
    """`hardware.virtual.firmware.RobotBody` on a ``simulated`` robot, in the robot's signs."""

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
        from motorprior.hardware.virtual.firmware import SensorReadings

        state = self.simulated.state()
        pos, vel = self._signs * state.joint_pos, self._signs * state.joint_vel
        current = np.zeros_like(pos) if self._drive is None else self._drive.current(pos, vel)
        return SensorReadings(pos, vel, current, state.attitude, state.rates)


def make_virtual_robot(robot: Robot, settings: VirtualRobotSettings) -> tuple[VirtualRobot, TwinBody]:
    """A virtual robot and its body, not yet running.

    Raises:
        ConfigError, ArtifactError: settings out of range, or an unknown fleet.
    """
    require_robot_extra()
    from motorprior.hardware.virtual.firmware import FirmwareConfig
    from motorprior.hardware.virtual.virtual_robot import VirtualRobot

    require_seed(settings.seed)
    motors = draw_motors(robot, load_robot_fleet(robot, settings.fleet, "robot.fleet"), settings.seed)
    body = TwinBody(robot, motors, settings.suspended, settings.seed)
    config = FirmwareConfig(1000 // settings.rate, settings.currents, homes=settings.homing)
    return VirtualRobot(robot, body, config), body


@contextmanager
def running_virtual_robot(robot_name: str, settings: VirtualRobotSettings) -> Iterator[str]:
    """Run a virtual robot in another process; yields its port.

    Raises:
        ConfigError, ArtifactError: see `make_virtual_robot`.
        RobotFault: it did not start.
    """
    context = get_context("spawn")
    connection, other_end = context.Pipe()
    process = context.Process(target=_run, args=(robot_name, settings, other_end), daemon=True)
    process.start()
    other_end.close()
    try:
        try:
            answer = connection.recv()
        except EOFError:
            raise RobotFault("no port", "the virtual robot did not start", remedy="see its output above") from None
        if isinstance(answer, MotorPriorError):
            raise answer
        if settings.homing:
            time.sleep(_HOMING_TIME)
        yield answer
    finally:
        connection.close()  # ends the robot, also if this process is killed
        process.join(timeout=10.0)
        process.kill()


def _run(robot_name: str, settings: VirtualRobotSettings, connection: Connection) -> None:
    """Send the port, or an error, and run until the other end of the connection is closed."""
    from motorprior.hardware.real_time import real_time

    os.setsid()  # the terminal's signals go to the host, which must crouch the robot
    try:
        virtual, _ = make_virtual_robot(load_robot(robot_name), settings)
    except MotorPriorError as error:
        connection.send(error)
        return
    connection.send(virtual.port)
    with real_time():
        virtual.run(connection.poll)
