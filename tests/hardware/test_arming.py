"""A person at a terminal: arms, steers, stops; and one who does not want to."""

import os
import pty
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from motorprior.hardware.virtual.firmware import IDLE, POSITION
from motorprior.logs.formats.robot_run import Mode


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


def modes_of(log: Path) -> set[Mode]:
    """What the robot has done so far; the last line may be in the making."""
    lines = log.read_text().splitlines()[1:-1] if log.is_file() else []
    return {Mode(int(line.split(",")[1])) for line in lines}


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


def test_what_was_typed_before_the_question_arms_nothing(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path
):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run")
    terminal.type("arm\n")
    terminal.read_until(b"press Enter")
    terminal.type("no\n")
    terminal.read_until(b"arm was not typed")
    assert terminal.process.wait(timeout=10.0) == 2 and pupper.received == 0


@pytest.mark.parametrize("option", ["--standing", None])
def test_the_words_before_a_recording_are_true(
    virtual: Callable, at_terminal: Callable, tmp_path: Path, when: Callable, option: str | None
):
    """Nobody steers a recording; Ctrl-C sits a standing robot down, and takes the current from a hung one at once."""
    pupper = virtual(hung=option is None)
    terminal = at_terminal("record", "--port", pupper.port, "--out", tmp_path / "run", *([option] if option else []))
    terminal.read_until(b"press Enter")
    assert b"no key does anything" in terminal.printed and b"q:" not in terminal.printed
    assert (b"sits down" in terminal.printed) == (option is not None)
    assert (b"at once" in terminal.printed) == (option is None)
    terminal.type("arm\n")
    log = tmp_path / "run" / "run.csv"
    deadline = time.monotonic() + 20.0
    while Mode.EXCITE not in modes_of(log):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    terminal.process.send_signal(signal.SIGINT)
    when(pupper, IDLE, patience=10.0)
    terminal.process.wait(timeout=10.0)
    assert (Mode.CROUCH in modes_of(log)) == (option is not None)


def test_a_lost_terminal_sits_down_and_idles(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path, when: Callable
):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run", "--yes", "--forward", 0.2)
    terminal.read_until(b"+0.20 m/s")
    terminal.hang_up()
    when(pupper, IDLE, patience=10.0)
    terminal.process.wait(timeout=10.0)
    assert modes_of(tmp_path / "run" / "run.csv") >= {Mode.RAMP, Mode.WALK, Mode.CROUCH}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_signal_while_it_waits_for_arm_sends_nothing(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path, number: signal.Signals
):
    pupper = virtual()
    terminal = at_terminal("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run")
    terminal.read_until(b"press Enter")
    terminal.process.send_signal(number)
    terminal.read_until(b"not armed")
    assert terminal.process.wait(timeout=10.0) == 2 and pupper.received == 0


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


def test_a_terminal_that_is_stopped_does_not_stop_the_walk(
    virtual: Callable, at_terminal: Callable, trot: Path, tmp_path: Path, when: Callable
):
    """Ctrl-S: words are lost, steps are not."""
    pupper = virtual()
    usual = ("deploy", trot, "--port", pupper.port, "--out", tmp_path / "run", "--yes")
    terminal = at_terminal(*usual, "--forward", 0.2, "--seconds", 3)
    terminal.read_until(b"+0.20 m/s")
    terminal.type("\x13")
    began = time.monotonic()
    when(pupper, IDLE, began, patience=10.0)
    assert when(pupper, IDLE, began) - began > 2.0, "nobody idled it before its time"
    terminal.type("\x11")
    assert terminal.process.wait(timeout=10.0) == 0
