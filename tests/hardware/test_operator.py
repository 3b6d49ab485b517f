"""The operator confirms arming, steers by keyboard and gamepad, and stops the robot."""

import os
import pty
import select
import struct
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.hardware.teleop import Teleop
from motorprior.hardware.virtual_robot import IDLE
from motorprior.robots.pupper_v2.robot import PUPPER_V2

GAIT = PUPPER_V2.require_gait()
VERTICAL = 1
HORIZONTAL = 0


class Terminal:
    """A process at its own terminal, with the bytes that it printed."""

    def __init__(self, command: list[str]):
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True
        )
        os.close(slave)
        self.printed = b""

    def type(self, text: str) -> None:
        os.write(self._master, text.encode())

    def read_until(self, words: bytes, patience: float = 30.0) -> None:
        deadline = time.monotonic() + patience
        while words not in self.printed:
            assert time.monotonic() < deadline, self.printed
            if select.select([self._master], [], [], 0.1)[0]:
                self.printed += os.read(self._master, 4096)


@pytest.mark.real_time
def test_a_robot_is_not_armed_without_confirmation(
    virtual: Callable, bare_command: list[str], trot: Path, tmp_path: Path
):
    robot = virtual()
    arguments = ["deploy", str(trot), "--port", robot.port, "--out", str(tmp_path / "run")]

    terminal = Terminal([*bare_command, *arguments])
    terminal.read_until(b"press Enter")
    terminal.type("no\n")

    assert terminal.process.wait(timeout=10.0) == 2
    assert not robot.firmware.events


@pytest.mark.real_time
def test_keys_arm_steer_and_stop_the_robot(
    virtual: Callable, bare_command: list[str], trot: Path, tmp_path: Path, when: Callable
):
    robot = virtual()
    arguments = ["deploy", str(trot), "--port", robot.port, "--out", str(tmp_path / "run")]
    terminal = Terminal([*bare_command, *arguments])
    try:
        terminal.read_until(b"press Enter")
        terminal.type("arm\n")
        terminal.read_until(b"+0.00 m/s")
        terminal.type("wwwa")
        terminal.read_until(b"+0.15 m/s +0.1 rad/s")
        terminal.type("q")
        terminal.read_until(b"stopped by operator")
        assert terminal.process.wait(timeout=10.0) == 0
        when(robot, IDLE)
    finally:
        terminal.process.kill()
        terminal.process.wait()


BUTTON = 1
STICK = 2


def event(value: int, event_type: int, number: int) -> bytes:
    """Bytes of an event of a gamepad: time [ms], value, type, number."""
    return struct.pack("<IhBB", 0, value, event_type, number)


def commanded(typed: bytes, pushed: bytes = b"", lost: bool = False) -> tuple[float, float] | None:
    """Command after these bytes of keyboard and gamepad; the terminal may be lost after them."""
    with ExitStack() as stack:
        keys, to_keys = os.pipe()
        stick, to_stick = os.pipe()
        for file in (keys, stick, to_stick):
            stack.callback(os.close, file)
        os.write(to_stick, pushed)
        os.write(to_keys, typed)
        if lost:
            os.close(to_keys)
        else:
            stack.callback(os.close, to_keys)
        return Teleop(keys, stick, GAIT, (0.3, 0.0)).command()


def test_q_a_gamepad_button_and_a_lost_terminal_stop():
    assert commanded(b"wq") is None
    assert commanded(b"", event(1, BUTTON, 1)) is None
    assert commanded(b"", lost=True) is None
    assert commanded(b"", event(0, BUTTON, 1)) == (0.3, 0.0), "a button that is released"


@given(
    keys=st.binary(min_size=1, max_size=60),
    stick=st.integers(-32767, 32767),
    turn=st.integers(-32767, 32767),
)
@settings(max_examples=60, deadline=None)
def test_the_command_stays_within_its_limits(keys: bytes, stick: int, turn: int):
    typed = keys.lower().replace(b"q", b"w")
    pushed = event(stick, STICK, VERTICAL) + event(turn, STICK, HORIZONTAL)

    command = commanded(typed, pushed)

    assert command is not None
    forward, yaw_rate = command
    assert GAIT.forward[0] <= forward <= GAIT.forward[1]
    assert abs(yaw_rate) <= GAIT.yaw_rate
