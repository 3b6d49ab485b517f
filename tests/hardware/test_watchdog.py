"""The operating system's part of safety, in real time: the watchdog process, and the port."""

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from motorprior.exceptions import RobotFault
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains
from motorprior.hardware.virtual.firmware import IDLE
from motorprior.logs.formats.robot_run import Mode, read_robot_run
from motorprior.robots.pupper_v2.robot import PUPPER_V2

pytestmark = pytest.mark.real_time


def rows(log: Path, mode: Mode) -> int:
    """Of a mode, in a recording that is being written."""
    return sum(line.split(",", 2)[1:2] == [str(int(mode))] for line in log.read_text().splitlines())


def hold(link: RobotLink, steps: int) -> None:
    """Arm, if it is not, and hold the present pose."""
    if link.target is None:
        gains = Gains.of(PUPPER_V2.require_wire())
        link.arm(gains.kp, gains.kd, gains.max_current)
    target = link.target
    assert target is not None
    for _ in range(steps):
        link.send(target, Mode.RAMP)
        link.receive(time.monotonic() + 0.01)


def test_a_killed_host_leaves_an_idle_robot_within_100_ms(
    virtual: Callable, bare_command: list[str], trot: Path, tmp_path: Path, when: Callable
):
    """Its recording survives."""
    pupper, log = virtual(), tmp_path / "run" / "run.csv"
    command = [*bare_command, "deploy", str(trot), "--port", pupper.port, "--out", str(log.parent), "--yes"]
    walking = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    try:
        give_up = time.monotonic() + 60.0
        while not log.is_file() or rows(log, Mode.WALK) < 30:
            assert walking.poll() is None and time.monotonic() < give_up, "it never walked"
            time.sleep(0.02)
        killed = time.monotonic()
    finally:
        walking.kill()
        walking.wait()
    assert when(pupper, IDLE, killed) - killed < 0.1
    time.sleep(0.15)
    assert pupper.events[-1][1] == IDLE, "nothing moves it again"
    assert read_robot_run(log, PUPPER_V2, (Mode.WALK,)).num_rows >= 30


def test_a_hanging_host_is_replaced_by_the_watchdog(virtual: Callable, host: Callable, when: Callable):
    """And cannot go on when it comes back."""
    pupper = virtual()
    link = host(pupper.port)
    hold(link, 10)
    assert when(pupper, IDLE) - pupper.events[-2][0] > 0.4, "not before the limit of 0.5 s"
    with pytest.raises(RobotFault, match="silent") as caught:
        hold(link, 1)
    assert caught.value.kind == "watchdog"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "stopped"])
def test_a_dead_watchdog_is_detected(virtual: Callable, host: Callable, number: signal.Signals):
    link = host(virtual().port)
    hold(link, 1)
    assert link._watchdog is not None
    os.kill(link._watchdog.pid, number)
    with pytest.raises(RobotFault, match="dead") as caught:
        hold(link, 300)
    assert caught.value.kind == "watchdog" and caught.value.safe_state == "crouch"
    link.ignore("watchdog")
    hold(link, 5)  # targets go on, for the crouch


def test_an_unplugged_robot_is_reported_with_a_remedy(virtual: Callable, host: Callable):
    pupper = virtual()
    link = host(pupper.port)
    hold(link, 5)
    pupper.stop()
    with pytest.raises(RobotFault, match="by hand") as caught:
        hold(link, 100)
    assert caught.value.kind == "unplugged"
    link.idle()  # must not fail


@pytest.mark.parametrize("full", [False, True], ids=["queue can be emptied", "queue stays full"])
def test_a_robot_that_reads_nothing_is_reported_and_idle_when_it_reads_again(
    virtual: Callable, host: Callable, when: Callable, monkeypatch: pytest.MonkeyPatch, full: bool
):
    """What the host can no longer send, the watchdog does."""
    pupper = virtual()
    link = host(pupper.port)
    hold(link, 5)
    if full:
        monkeypatch.setattr("motorprior.hardware.serial_link.termios.tcflush", lambda *_: None)
    monkeypatch.setattr(pupper, "_read", lambda: time.sleep(0.002) or b"")
    with pytest.raises(RobotFault, match="takes no more bytes"):
        while (target := link.target) is not None:
            link.send(target, Mode.RAMP)
    link.idle()
    assert (link._port.unsent > 0) == full
    monkeypatch.undo()
    when(pupper, IDLE)
