"""The watchdog is there when the host is not, and the host hears when the watchdog is not.

The one test with a clock in it stands here: the 100 ms after the death of the host are what the watchdog is for. What
else this machine does can only add to them, so three deaths of six are enough.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from motorprior.hardware.virtual.firmware import IDLE
from motorprior.hardware.virtual.virtual_robot import VirtualRobot
from motorprior.logs.formats.robot_run import Mode, read_robot_run
from motorprior.robots.pupper_v2.robot import PUPPER_V2

ATTEMPTS, ENOUGH, WALKED = 6, 3, 30


def walked(log: Path) -> int:
    """Rows of walking in a recording that is being written."""
    lines = log.read_text().splitlines()[1:] if log.is_file() else []
    return sum(line.split(",", 2)[1:2] == [str(int(Mode.WALK))] for line in lines)


def kill_while_walking(pupper: VirtualRobot, walking: subprocess.Popen, log: Path) -> float | None:
    """SIGKILL to a host that walks; when [s], None if this machine was too busy for a walk, and the host said so."""
    give_up = time.monotonic() + 60.0
    while walked(log) < WALKED:
        if walking.poll() is not None:
            return None
        assert time.monotonic() < give_up, "it never walked"
        time.sleep(0.02)
    killed = time.monotonic()
    os.kill(walking.pid, signal.SIGKILL)
    return killed


@pytest.mark.flaky(reruns=1)
def test_a_killed_host_leaves_an_idle_robot_within_100_ms(
    virtual: Callable, deploying: Callable, trot: Path, tmp_path: Path, when: Callable
):
    """SIGKILL while walking, until a machine that stands still at times let it be seen."""
    took = []
    for number in range(ATTEMPTS):
        pupper, log = virtual(), tmp_path / str(number) / "run.csv"
        killed = kill_while_walking(pupper, deploying(pupper.port, trot, log.parent), log)
        if killed is None:
            pupper.stop()
            continue
        took.append(when(pupper, IDLE, killed) - killed)
        time.sleep(0.15)
        assert pupper.events[-1][1] == IDLE, "nothing moves it again"
        assert read_robot_run(log, PUPPER_V2, (Mode.WALK,)).num_rows >= WALKED, "the recording survives"
        pupper.stop()
        if sum(each < 0.1 for each in took) == ENOUGH:
            return
    pytest.fail(f"idle within 0.1 s of fewer than {ENOUGH} deaths: {took}")
