"""Reaction times of a walking host to faults, until the virtual robot is at rest; for `hardware.py`.

Faults of the robot are injected at a time of its own; those of the host happen in its control loop, or from outside it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from full_disk import file_sizes_restored, limit_file_sizes
from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.machine import STOOD_STILL, BareTimers, explained
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.run_facts import FACTS
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import StopRequest
from motorprior.locomotion.policy import Policy
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.load import load_robot

MOST_FAULTS = 5
SPEED = 0.3
"""Commanded [m/s]."""
WORDS = "words.txt"
"""Output of the robots and hosts of other processes, in the folder of the measurement."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
FAULT_AT = 7.0
"""Robot time at which injected faults begin [s]; the robot walks by then."""
_STOPPED = frozenset({"stuck", "tracking"})
FAULTS = {
    "frozen:FR_knee": _STOPPED,
    "jumping:FL_hip": frozenset({"implausible telemetry"}),
    "stalled:RR_knee": _STOPPED,
    "dead:FR_knee": _STOPPED | {"fall"},
    "tilted": frozenset({"fall"}),
    "hot_current:RL_hip": frozenset({"current"}),
    "mute": frozenset({"stale telemetry"}),
    "lagging": frozenset({"stale telemetry"}),
    "restart": frozenset({"implausible telemetry"}),
    "hot_motor:FL_knee": frozenset({"temperature"}),
    "flat": frozenset({"battery"}),
    "numb": frozenset({"frozen IMU"}),
    "blind": frozenset({"frozen IMU"}),
    "surge:FL_hip": frozenset({"firmware"}),
    "deaf": _STOPPED | {"unplugged"},
    "unplugged": frozenset({"unplugged"}),
}
"""Faults of the robot, and the kinds under which the host may report each; any other one is not the reaction to it."""
_WHOLE = ("fall", "implausible telemetry", "firmware")
"""Kinds whose message names no joint."""
SAID = ("surge", "deaf", "unplugged")
"""Faults in which the robot loses its current by itself or cannot be reached: the time until the host reports is
measured."""
LATE = 0.11
"""Duration of a step that is too late for the host, but not for the watchdog [s]."""
LONGEST_START = 120.0
"""Longest wait for a host to have walked for a while [s]."""
STATUS_BEFORE = 6
"""Number of status lines, two a second, before a fault of the host."""


def is_meant(found: RobotFault, fault: str) -> bool:
    """Whether the host reported the injected fault, of the joint that has it, and not a silence of this machine."""
    joint = fault.partition(":")[2]
    named = found.kind in _WHOLE or joint in str(found)
    return found.kind in FAULTS[fault] and named and STOOD_STILL not in str(found)


class NotMeasuredError(Exception):
    """The machine is too busy, or a fault had no effect."""


@contextmanager
def virtual_robot(folder: Path, *options: str) -> Iterator[tuple[str, Callable[[], dict]]]:
    """A virtual robot in its own process: its port, and a function that returns its statistics afterwards."""
    link, life = folder / "port", folder / "life.json"
    life.unlink(missing_ok=True)
    command = [sys.executable, "-m", "motorprior", "virtual-robot", "--link", str(link), "--json", str(life)]
    with open(folder / WORDS, "a") as words:
        process = subprocess.Popen([*command, "--robot.no-homing", *options], stderr=words)

    def end() -> dict:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=20.0)
        return json.loads(life.read_text())

    try:
        while not link.is_symlink():
            if process.poll() is not None:
                raise NotMeasuredError("the virtual robot did not start")
            time.sleep(0.01)
        yield str(link), end
    finally:
        process.kill()
        process.wait()


def deploy(
    port: str,
    policy: Policy,
    seconds: float,
    log: Path | None = None,
    timing: Timing | None = None,
    status: Callable[[RobotLink], None] = lambda _: None,
) -> None:
    """Walk, from this process; ``status`` is called in the control loop, twice a second."""
    robot = load_robot(policy.robot)
    recorder = None if log is None else Recorder(robot, log)
    with RobotLink(robot, SerialLink(robot, port), recorder=recorder) as link:
        gains, stop = gains_for(robot, policy), StopRequest()
        walk(
            link, policy, gains, stop,
            command=(SPEED, 0.0), seconds=seconds, timing=timing, status=lambda _: status(link),
        )  # fmt: skip


def signal_to_idle(
    folder: Path, policy: Path, number: signal.Signals, patience: float = 0.5, others: list[str] | None = None
) -> float:
    """Milliseconds from a signal to a walking host until the robot is idle, which takes less than ``patience`` [s].

    A host that another fault ended is not counted, but named in ``others``.
    """
    others = [] if others is None else others
    for _ in range(MOST_FAULTS):
        out = Path(tempfile.mkdtemp(dir=folder)) / "run"
        with virtual_robot(folder) as (port, end):
            command = ["-m", "motorprior.hardware", "deploy", str(policy), "--port", port, "--out", str(out), "--yes"]
            command += ["--forward", str(SPEED)]
            with open(folder / WORDS, "a") as words:
                host = subprocess.Popen([sys.executable, *command], stdin=subprocess.DEVNULL, stderr=words)
            try:
                walks = wait_until_it_walks(host, out / "run.csv")
                if walks:
                    before = time.monotonic()
                    os.kill(host.pid, number)
                    time.sleep(patience)
                    if outcome(out) == (number.name if number in SIGNALS else None):
                        return 1e3 * (first_idle(end(), before) - before)
                others.append((outcome(out) or "none yet") if walks else "did not walk")
            finally:
                host.kill()
                host.wait()
    raise NotMeasuredError(f"this machine is too busy: the host did not end by {number.name}")


def outcome(out: Path) -> str | None:
    """What ended a run, in the words of its run.json; None if nothing did that it could still write down."""
    try:
        return json.loads((out / FACTS).read_text()).get("outcome")
    except (OSError, ValueError):
        return "no facts"


def wait_until_it_walks(host: subprocess.Popen, log: Path) -> bool:
    """False if the host ended before, or did not walk within `LONGEST_START`: this machine was too busy."""
    give_up = time.monotonic() + LONGEST_START
    while host.poll() is None and not (log.is_file() and log.stat().st_size > 200_000):  # 4 s under way
        if time.monotonic() > give_up:
            return False
        time.sleep(0.01)
    return host.poll() is None


def first_idle(life: dict, after: float) -> float:
    """When the robot became idle [s]."""
    times = [at for at, mode in life["modes"] if mode == "idle" and at >= after]
    if not times:
        raise NotMeasuredError("the robot was never idle")
    return min(times)


def reaction(folder: Path, policy: Policy, fault: str, others: list[str] | None = None) -> float:
    """Milliseconds from an injected fault until the robot is idle, or, unplugged, until the host says so.

    Args:
        folder: for files.
        policy: to walk with.
        fault: a key of FAULTS.
        others: gets the kind of every fault that was not meant; such a trial is repeated.

    Raises:
        NotMeasuredError: the host walked on, or reported something else every time.
    """
    others = [] if others is None else others
    for _ in range(MOST_FAULTS):
        with virtual_robot(folder, "--robot.currents", "--robot.fault", f"{fault}@{FAULT_AT:g}") as (port, end):
            timing, timers = Timing(), BareTimers()
            try:
                deploy(port, policy, 2.0 * FAULT_AT, timing=timing)
                raise NotMeasuredError(f"walked on in spite of {fault}")
            except RobotFault as error:
                said, found = time.monotonic(), error
            finally:
                machine = timers.stop()
            time.sleep(0.1)
            life = end()
        found = explained(found, machine, timing, policy.control_dt)
        print(f"  {fault}: {found}", file=sys.stderr)
        began = life["started"] + FAULT_AT
        if said > began and is_meant(found, fault):  # otherwise the host sat down before the fault, or for another one
            return 1e3 * ((said if fault.partition(":")[0] in SAID else first_idle(life, began)) - began)
        others.append(found.kind)
    raise NotMeasuredError(f"this machine is too busy: {fault} was never reported, but {', '.join(others)}")


def kill_watchdog(link: RobotLink) -> None:
    """SIGKILL to the watchdog process."""
    assert link._guardian is not None
    os.kill(link._guardian.pid, signal.SIGKILL)


def stop_watchdog(link: RobotLink) -> None:
    """SIGSTOP to the watchdog process: found when its pipe is full, after a second."""
    assert link._guardian is not None
    os.kill(link._guardian.pid, signal.SIGSTOP)


def raise_an_exception(_: RobotLink) -> None:
    """A bug in the program."""
    raise ZeroDivisionError("a bug")


def command_nonsense(link: RobotLink) -> None:
    """A policy that computes NaN."""
    link.send(np.full(link.robot.num_joints, np.nan), Mode.WALK)


def come_late(_: RobotLink) -> None:
    """A busy computer."""
    time.sleep(LATE)


def fill_the_disk(_: RobotLink) -> None:
    """No file may grow any more."""
    limit_file_sizes(0)


@dataclass(frozen=True)
class HostFault:
    """A fault of the host, and what the host says of it.

    Attributes:
        happens: called in the control loop.
        error: that ends the walk.
        kind: of a `RobotFault`; empty for other errors.
    """

    happens: Callable[[RobotLink], None]
    error: type[Exception]
    kind: str = ""

    def is_meant(self, found: Exception) -> bool:
        """Whether this, and nothing else, ended the walk."""
        return isinstance(found, self.error) and (not self.kind or getattr(found, "kind", "") == self.kind)


HOST_FAULTS = {
    "watchdog_dead": HostFault(kill_watchdog, RobotFault, "watchdog"),
    "watchdog_asleep": HostFault(stop_watchdog, RobotFault, "watchdog"),
    "exception": HostFault(raise_an_exception, ZeroDivisionError),
    "not_finite": HostFault(command_nonsense, RobotFault, "impossible command"),
    "slow_host": HostFault(come_late, RobotFault, "slow host"),
    "full_disk": HostFault(fill_the_disk, ArtifactError),
}


def host_reaction(folder: Path, policy: Policy, fault: HostFault, others: list[str] | None = None) -> float:
    """Milliseconds from something that happens in the host until the robot is idle.

    Args:
        folder: for files.
        policy: to walk with.
        fault: of the host.
        others: gets what ended every walk that it did not; such a trial is repeated.

    Raises:
        NotMeasuredError: the host walked on, or something else ended the walk every time.
    """
    name, others = fault.happens.__name__, [] if others is None else others
    for _ in range(MOST_FAULTS):
        calls, began = 0, float("inf")

        def status(link: RobotLink) -> None:
            nonlocal calls, began
            calls += 1
            if calls == STATUS_BEFORE:
                began = time.monotonic()
                fault.happens(link)

        log = Path(tempfile.mkdtemp(dir=folder)) / "run.csv"
        with virtual_robot(folder) as (port, end):
            found = None
            with file_sizes_restored():
                try:
                    deploy(port, policy, 2.0 * FAULT_AT, log, status=status)
                except (MotorPriorError, ZeroDivisionError) as error:
                    found = error
            if found is None:
                raise NotMeasuredError(f"walked on in spite of {name}")
            print(f"  {name}: {found}", file=sys.stderr)
            time.sleep(0.1)
            life = end()
        if began < float("inf") and fault.is_meant(found):  # otherwise this machine was too busy
            return 1e3 * (first_idle(life, began) - began)
        others.append(str(found)[:80])
    raise NotMeasuredError(f"this machine is too busy: {name} was never reported, but {'; '.join(others)}")


def reactions(folder: Path, path: Path) -> dict[str, Callable[[], dict[str, float]]]:
    """How to measure reaction_ms/FAULT of every fault, one trial each, and the trials that others ended."""
    policy = Policy.load(path)
    robot = {fault.partition(":")[0]: partial(reaction, folder, policy, fault) for fault in FAULTS}
    host = {name: partial(host_reaction, folder, policy, fault) for name, fault in HOST_FAULTS.items()}
    signals = {number.name: partial(signal_to_idle, folder, path, number, patience=6.0) for number in SIGNALS}
    return {name: partial(_counted, name, measure) for name, measure in (robot | host | signals).items()}


def _counted(name: str, measure: Callable[..., float]) -> dict[str, float]:
    others: list[str] = []
    took = measure(others=others)
    return {f"reaction_ms/{name}": took, f"reaction_others/{name}": float(len(others))}
