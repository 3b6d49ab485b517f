"""A virtual robot in this process, or in another one for the commands deploy, record and doctor."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Literal

from motorprior.bounds import require_seed
from motorprior.exceptions import MotorPriorError, RobotFault
from motorprior.hardware.settings import require_robot_extra
from motorprior.robots.load import load_robot

if TYPE_CHECKING:
    from motorprior.hardware.virtual_robot import VirtualRobot
    from motorprior.robots.robot import Robot
    from motorprior.simulation.simulated_robot import SimulatedRobot

_MAX_START = 60.0  # [s] until the virtual robot has a port
_MAX_END = 10.0  # [s] until its process has ended


@dataclass(frozen=True)
class VirtualRobotSettings:
    """A simulated robot behind the interface of a real one, a pseudo-terminal, in real time."""

    fleet: str | None = None
    """Fleet of the virtual robot's motors; the robot's fleet if not given."""
    seed: int = 0
    """Number of the virtual robot; every number has other motors."""
    suspended: bool = False
    """The robot is suspended in the air; otherwise it is on the ground."""
    rate: Literal[100, 200] = 100
    """Telemetry frames per second."""
    currents: bool = False
    """The firmware sends motor currents."""
    imu: bool = True
    """The firmware reads the IMU; otherwise it sends zeros, as the current firmware does."""


def make_virtual_robot(
    robot: "Robot", settings: VirtualRobotSettings
) -> "tuple[VirtualRobot, SimulatedRobot]":
    """A virtual robot and its simulation, not yet running; ConfigError for a bad seed or fleet."""
    require_robot_extra()
    # here: the robot's own computer has no simulator
    from motorprior.actuator.fleet import load_robot_fleet
    from motorprior.hardware.virtual_robot import Firmware, VirtualRobot
    from motorprior.simulation.simulated_robot import SimulatedRobot, draw_motors

    require_seed(settings.seed)
    fleet = load_robot_fleet(robot, settings.fleet, "virtual_robot.fleet")
    motors = draw_motors(robot, fleet, settings.seed)
    simulated_robot = SimulatedRobot(robot, motors, settings.suspended, settings.seed)
    frame_period = 1000 // settings.rate  # [ms]
    firmware = Firmware(robot, simulated_robot, frame_period, settings.currents, settings.imu)
    return VirtualRobot(firmware), simulated_robot


@contextmanager
def running_virtual_robot(robot_name: str, settings: VirtualRobotSettings) -> Iterator[str]:
    """Run a virtual robot in another process; yields its port.

    Raises as `make_virtual_robot`, or RobotFault if it does not start.
    """
    context = get_context("spawn")
    connection, other_end = context.Pipe()
    process = context.Process(target=_run, args=(robot_name, settings, other_end), daemon=True)
    process.start()
    other_end.close()
    try:
        yield _received_port(connection)
    finally:
        connection.close()  # ends the robot, also if this process is killed
        process.join(timeout=_MAX_END)
        process.kill()


def _received_port(connection: Any) -> str:
    """The port that the other process sends; raises the error that it sends instead."""
    answer = None
    with suppress(EOFError):  # the process died
        if connection.poll(_MAX_START):
            answer = connection.recv()

    if isinstance(answer, MotorPriorError):
        raise answer
    if answer is None:
        raise RobotFault(
            "no port", "the virtual robot did not start", remedy="see its output above"
        )
    return answer


def _run(robot_name: str, settings: VirtualRobotSettings, connection: Connection) -> None:
    """Send the port, or an error, and run until the other end of the connection is closed."""
    from motorprior.hardware.control_loop import real_time

    os.setsid()  # the terminal's signals go to the host, which must crouch the robot
    try:
        virtual_robot, simulated_robot = make_virtual_robot(load_robot(robot_name), settings)
    except MotorPriorError as error:
        connection.send(error)
        return

    start = simulated_robot.position()
    connection.send(virtual_robot.port)
    with real_time():
        virtual_robot.run(connection.poll)
    forward, left = simulated_robot.position() - start
    print(f"virtual robot: walked {forward:+.2f} m forward, {left:+.2f} m left", file=sys.stderr)
