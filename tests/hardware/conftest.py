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

# For a busy computer; the real limits are tested in simulated time.
PATIENT = replace(
    PUPPER_V2.require_wire().safety,
    tick_delay=100.0, late_ticks=100, stalled_time=100.0, telemetry_age=0.5, watchdog=0.5,
)  # fmt: skip


@pytest.fixture(scope="session")
def trot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy of zero weights: it trots as commanded."""
    path = tmp_path_factory.mktemp("policy") / "policy.safetensors"
    as_file_content(PolicyShape(12).untrained()).save(path)
    return path


class ObservedFirmware(Firmware):
    """Its ``events`` are (time on the monotonic clock [s], IDLE or "command"), one per command."""

    def __init__(self, robot: Robot, body: SimulatedRobot):
        super().__init__(robot, body)
        self.events: list[tuple[float, str]] = []

    def execute(self, command: Command) -> None:
        super().execute(command)
        self.events.append((time.monotonic(), IDLE if command.idle else "command"))


@pytest.fixture
def virtual() -> Iterator[Callable[..., VirtualRobot]]:
    """Start a virtual Pupper that holds its pose at once, in a thread; all end with the test."""
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
    """A host's side of a port; idle when the test ends."""
    with ExitStack() as stack:

        def connect(port: str) -> RobotLink:
            made = stack.enter_context(RobotLink(PUPPER_V2, SerialLink(PUPPER_V2, port), PATIENT))
            made.receive(time.monotonic() + 0.15)
            return made

        yield connect


@pytest.fixture
def when() -> Callable[..., float]:
    """The first time [s, monotonic] after ``after`` at which a robot was sent a command of a kind."""

    def find(robot: Any, what: str, after: float = 0.0, patience: float = 5.0) -> float:
        give_up = time.monotonic() + patience
        while time.monotonic() < give_up:
            if times := [
                at for at, event in list(robot.firmware.events) if event == what and at >= after
            ]:
                return times[0]
            time.sleep(0.005)
        raise AssertionError(f"never {what}: {[event for _, event in robot.firmware.events][-5:]}")

    return find


@pytest.fixture(scope="session")
def bare_command() -> list[str]:
    """The command line of the robot's computer, without numba and all the rest."""
    return [
        sys.executable,
        str(Path(__file__).with_name("bare_environment.py")),
        "motorprior.__main__",
    ]
