"""Virtual Puppers at real pseudo-terminals, and hosts that drive them in real time."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
from policies import as_file_content

from motorprior.commands.virtual_robot import VirtualRobotSettings, make_virtual_robot
from motorprior.hardware.protocol import Command
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.virtual_robot import IDLE, Firmware, VirtualRobot
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Robot
from motorprior.simulation.simulated_robot import SimulatedRobot

# Limits for a busy computer; the real limits are tested in simulated time.
PATIENT = replace(
    PUPPER_V2.require_wire().safety,
    tick_delay=100.0,
    late_ticks=100,
    stalled_time=100.0,
    telemetry_age=0.5,
    watchdog=0.5,
)


@pytest.fixture(scope="session")
def trot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of the policy of zero weights, which trots as commanded."""
    path = tmp_path_factory.mktemp("policy") / "policy.safetensors"
    as_file_content(PolicyShape(12).untrained()).save(path)
    return path


class ObservedFirmware(Firmware):
    """Firmware with ``events``: (monotonic time [s], IDLE or "command"), one per command."""

    def __init__(self, robot: Robot, body: SimulatedRobot):
        super().__init__(robot, body)
        self.events: list[tuple[float, str]] = []

    def execute(self, command: Command) -> None:
        super().execute(command)
        self.events.append((time.monotonic(), IDLE if command.idle else "command"))


@pytest.fixture
def virtual() -> Iterator[Callable[..., VirtualRobot]]:
    """Function that starts a virtual Pupper in a thread; it ends with the test."""
    with ExitStack() as stack:

        def start() -> VirtualRobot:
            robot, body = make_virtual_robot(PUPPER_V2, VirtualRobotSettings())
            robot.firmware = ObservedFirmware(PUPPER_V2, body)
            unplugged = Event()
            thread = Thread(target=robot.run, args=(unplugged.is_set,), daemon=True)
            thread.start()
            stack.callback(thread.join, timeout=60.0)
            robot.unplug = stack.callback(unplugged.set)  # pyright: ignore[reportAttributeAccessIssue]
            return robot

        yield start


@pytest.fixture
def host() -> Iterator[Callable[[str], RobotLink]]:
    """Function that connects a host to a port; the host sends idle when the test ends."""
    with ExitStack() as stack:

        def connect(port: str) -> RobotLink:
            link = RobotLink(PUPPER_V2, SerialLink(PUPPER_V2, port), PATIENT)
            stack.enter_context(link)
            link.receive(time.monotonic() + 0.15)
            return link

        yield connect


@pytest.fixture
def when() -> Callable[..., float]:
    """Function for the monotonic time [s] of the first ``event`` of a robot after ``after``."""

    def find(robot: Any, event: str, after: float = 0.0, patience: float = 5.0) -> float:
        give_up = time.monotonic() + patience
        while time.monotonic() < give_up:
            for at, event_of_robot in list(robot.firmware.events):
                if event_of_robot == event and at >= after:
                    return at
            time.sleep(0.005)
        raise AssertionError(f"never {event}: {robot.firmware.events[-5:]}")

    return find


@pytest.fixture(scope="session")
def bare_command() -> list[str]:
    """The command line in the environment of the robot's computer."""
    script = Path(__file__).with_name("bare_environment.py")
    return [sys.executable, str(script), "motorprior.__main__"]
