"""Faults of the operating system in real time: the host, the watchdog process and the port."""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import pytest

from motorprior.exceptions import RobotFault
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.virtual_robot import IDLE, VirtualRobot
from motorprior.logs.readers.deploy_recording import Mode, read_deploy_recording
from motorprior.robots.pupper_v2.robot import PUPPER_V2

pytestmark = pytest.mark.real_time
WATCHDOG_TIME = 0.5  # [s], see conftest.PATIENT


def hold(link: RobotLink, steps: int) -> None:
    """Arm the robot, if it is not armed, and hold its pose for these steps."""
    if link.gate.target is None:
        link.arm(Gains.of(PUPPER_V2.require_wire()))
    target = link.gate.target
    assert target is not None
    for _ in range(steps):
        link.send(target, Mode.RAMP)
        link.receive(time.monotonic() + 0.01)


def signal_watchdog(number: signal.Signals) -> Callable[[VirtualRobot, RobotLink], None]:
    def send(_: VirtualRobot, link: RobotLink) -> None:
        assert link._watchdog is not None
        os.kill(link._watchdog._process.pid, number)

    return send


FAULTS = {
    "host hangs": (lambda *_: time.sleep(WATCHDOG_TIME + 0.2), "watchdog", "idle"),
    "watchdog killed": (signal_watchdog(signal.SIGKILL), "watchdog", "crouch"),
    "watchdog stopped": (signal_watchdog(signal.SIGSTOP), "watchdog", "crouch"),
    "unplugged": (lambda robot, _: robot.unplug(), "unplugged", "idle"),
}
"""Cause, name and safe state of a fault."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_detected_and_its_reaction_possible(
    virtual: Callable, host: Callable, when: Callable, name: str
):
    happens, fault_name, safe_state = FAULTS[name]
    robot = virtual()
    link = host(robot.port)
    hold(link, 10)

    happens(robot, link)
    with pytest.raises(RobotFault) as refused:
        hold(link, 300)

    assert refused.value.name == fault_name
    assert refused.value.safe_state == safe_state
    if name == "host hangs":
        last = max(at for at, event in robot.firmware.events if event == "command")
        assert when(robot, IDLE) - last > WATCHDOG_TIME - 0.1, "not before the limit"
    if safe_state == "crouch":
        link.ignore(fault_name)
        hold(link, 5)  # targets go on, for the crouch
    link.idle()  # must not fail


def walking_rows(log: Path) -> int:
    """Number of rows of a recording in the mode of walking; 0 if there is no recording yet."""
    if not log.exists():
        return 0
    rows = [row.split(",") for row in log.read_text().splitlines()]
    return sum(row[1:2] == [str(int(Mode.WALK))] for row in rows)


def test_a_killed_host_leaves_an_idle_robot_within_100_ms(
    virtual: Callable, bare_command: list[str], trot: Path, tmp_path: Path, when: Callable
):
    robot = virtual()
    log = tmp_path / "run" / "run.csv"
    arguments = ["deploy", str(trot), "--port", robot.port, "--out", str(log.parent), "--yes"]
    walking = subprocess.Popen([*bare_command, *arguments], stdin=subprocess.DEVNULL)
    try:
        give_up = time.monotonic() + 60.0
        while walking_rows(log) < 30:
            assert walking.poll() is None, "it never walked"
            assert time.monotonic() < give_up, "it never walked"
            time.sleep(0.02)
        killed = time.monotonic()
    finally:
        walking.kill()
        walking.wait()

    assert when(robot, IDLE, killed) - killed < 0.1
    time.sleep(0.15)
    assert robot.firmware.events[-1][1] == IDLE, "nothing moves it again"
    assert read_deploy_recording(log, PUPPER_V2, (Mode.WALK,)).num_rows >= 30


@pytest.mark.parametrize("full", [False, True], ids=["queue can be emptied", "queue stays full"])
def test_a_robot_that_reads_nothing_is_idle_when_it_reads_again(
    virtual: Callable, host: Callable, when: Callable, full: bool
):
    robot = virtual()
    link = host(robot.port)
    hold(link, 5)
    with contextlib.ExitStack() as stack:
        if full:
            stack.enter_context(mock.patch("motorprior.hardware.serial_link.termios.tcflush"))
        stack.enter_context(mock.patch.object(robot, "_read", lambda: time.sleep(0.002) or b""))
        with pytest.raises(RobotFault) as refused:
            while (target := link.gate.target) is not None:
                link.send(target, Mode.RAMP)
        assert refused.value.name == "unplugged"
        assert refused.value.__cause__ is None, "the port is open and accepts no bytes"
        assert robot.port in str(refused.value)
        link.idle()
    when(robot, IDLE)
