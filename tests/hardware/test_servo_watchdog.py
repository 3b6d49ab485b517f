"""Hosts of servos that die or hang: the watchdog process switches the torque off, in real time."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from motorprior.commands.servo_bus import chain_of_one
from motorprior.hardware.buses.virtual_bus import VirtualBus
from motorprior.hardware.buses.virtual_servo import DYNAMIXEL_XL330
from motorprior.robots.servos import ServoCommand, ServoState

pytestmark = pytest.mark.real_time
PATIENCE = 30.0  # [s]


class IdealMotor:
    """A motor that reaches its goal at once."""

    step = 0.001

    def __init__(self) -> None:
        self._pos = np.zeros(1)

    def set_command(self, command: ServoCommand) -> None:
        if command.enabled[0]:
            self._pos = command.target.copy()

    def advance(self, steps: int) -> None:
        pass

    def state(self) -> ServoState:
        return ServoState(self._pos.copy(), np.zeros(1), np.zeros(1))


@pytest.fixture
def bus() -> Iterator[VirtualBus]:
    chain = chain_of_one("XL330-M288", 7)
    with VirtualBus(DYNAMIXEL_XL330, chain, IdealMotor(), in_real_time=True) as virtual:
        yield virtual


@pytest.fixture
def host(bus: VirtualBus, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The command record at the bus, moving, in the environment of the robot's computer."""
    pytest.importorskip("rustypot")
    motor = ("--motor", "XL330-M288", "--id", "7", "--bar", "0.1m,0.2kg", "--seconds", "60")
    bare = str(Path(__file__).with_name("bare_environment.py"))
    record = ("motorprior.__main__", "record", "--port", bus.port, *motor, "--yes")
    command = [sys.executable, bare, *record]
    process = subprocess.Popen(
        [*command, "--out", str(tmp_path / "run")], stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if "1 of" in line:
                break
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def eventually(condition: Callable[[], bool]) -> bool:
    """Whether a condition becomes true in time."""
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        if condition():
            return True
        time.sleep(0.02)
    return False


def has_torque(bus: VirtualBus) -> bool:
    return bool(bus.servos[0].get("torque_enable"))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_dies_or_hangs_leaves_no_torque(
    bus: VirtualBus, host: subprocess.Popen[str], how: signal.Signals
):
    assert has_torque(bus)

    os.kill(host.pid, how)

    assert eventually(lambda: not has_torque(bus))
    assert eventually(lambda: bus.servos[0].get("bus_watchdog") == 0), "ready for the next host"
    assert bus.servos[0].eeprom_writes == 0


def test_a_servo_stops_by_itself_when_host_and_watchdog_die(
    bus: VirtualBus, host: subprocess.Popen[str]
):
    assert bus.servos[0].get("bus_watchdog") == 25, "0.5 s in units of 20 ms"
    processes = Path(f"/proc/{host.pid}/task/{host.pid}/children").read_text().split()
    assert processes

    for process in (*processes, host.pid):
        os.kill(int(process), signal.SIGKILL)

    assert eventually(lambda: bus.servos[0].get("bus_watchdog") == -1)
    assert has_torque(bus), "it holds its position"
    assert bus.servos[0].get("goal_position") == bus.servos[0].get("position")


def test_a_pulled_cable_ends_the_recording_with_a_message(
    bus: VirtualBus, host: subprocess.Popen[str]
):
    bus.unplug()

    assert host.stderr is not None
    text = host.stderr.read()

    assert host.wait(PATIENCE) == 2
    assert "robot fault 'silence'" in text
    assert "cable" in text
