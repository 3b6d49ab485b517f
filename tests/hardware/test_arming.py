"""A person at a terminal: arms, steers, stops; and one who does not want to."""

import os
import pty
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from motorprior.hardware.virtual.firmware import IDLE, POSITION


class Terminal:
    """A process at a terminal of its own, and what it printed."""

    def __init__(self, command: list[str]):
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, start_new_session=True)
        os.close(slave)
        self.printed = b""

    def type(self, text: str) -> None:
        os.write(self._master, text.encode())

    def read_until(self, words: bytes, patience: float = 30.0) -> None:
        deadline = time.monotonic() + patience
        while words not in self.printed:
            assert time.monotonic() < deadline, self.printed
            if select.select([self._master], [], [], 0.1)[0]:
                try:
                    self.printed += os.read(self._master, 4096)
                except OSError as error:
                    raise AssertionError(f"it ended: {self.printed}") from error

    def hang_up(self) -> None:
        os.close(self._master)


@pytest.fixture
def at_terminal(bare_command: list[str]) -> Iterator[Callable[..., Terminal]]:
    started = []

    def start(*arguments: object) -> Terminal:
        started.append(Terminal([*bare_command, *map(str, arguments)]))
        return started[-1]

    yield start
    for terminal in started:
        terminal.process.kill()
        terminal.process.wait()


def test_arm_walk_and_sit_down_by_keys(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path, when: Callable
):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run")
    terminal.read_until(b"press Enter")
    assert pupper.received == 0, "nothing is sent before somebody armed it"
    terminal.type("arm\n")
    when(pupper, POSITION, patience=10.0)
    terminal.read_until(b"+0.00 m/s")
    terminal.type("wwwa")
    terminal.read_until(b"+0.15 m/s +0.1 rad/s")
    terminal.type("q")
    terminal.read_until(b"stopped by pilot")
    assert terminal.process.wait(timeout=10.0) == 0
    when(pupper, IDLE)


def test_another_word_sends_nothing(virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run")
    terminal.read_until(b"press Enter")
    terminal.type("no\n")
    terminal.read_until(b"arm was not typed")
    assert terminal.process.wait(timeout=10.0) == 2 and pupper.received == 0
    assert not (tmp_path / "run").exists()


def test_a_robot_that_fell_while_somebody_hesitated_is_not_armed(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path
):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run")
    terminal.read_until(b"press Enter")
    pupper.break_down("tilted")
    time.sleep(2.5)  # telemetry overflows the buffers of the port meanwhile
    terminal.type("arm\n")
    terminal.read_until(b"fall")
    assert terminal.process.wait(timeout=10.0) == 2 and pupper.received == 0
