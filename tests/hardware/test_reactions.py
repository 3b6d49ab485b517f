"""Every fault of the table in docs/hardware.md, on a virtual Pupper that walks: it is seen, and the safe state reached.

What happens stands here, and in test_watchdog.py where the host is dead; how fast, in benchmarks/hardware.py.
"""

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import ArtifactError, RobotFault
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.motions import Walker
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, StopRequest, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.virtual.firmware import ERROR, IDLE, POSITION
from motorprior.locomotion.policy import Policy
from motorprior.logs.formats.robot_run import Mode, read_robot_run
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WIRE = PUPPER_V2.require_wire()
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
STEPS_BEFORE, STEPS_AFTER = 30, 300
SENSED = [
    ("frozen", "FR_knee", {"stuck"}),
    ("jumping", "FL_hip", {"implausible telemetry"}),
    ("stalled", "RR_knee", {"stuck", "tracking"}),
    ("dead", "FR_knee", {"stuck", "tracking", "fall"}),
    ("tilted", None, {"fall"}),
    ("hot_current", "RL_hip", {"current"}),
    ("mute", None, {"stale telemetry"}),
    ("lagging", None, {"stale telemetry"}),
    ("restart", None, {"implausible telemetry"}),
]
BEFORE_RESTART = 2.0
"""A clock that goes back by less [s] is that of an old frame: such a robot says nothing new, its telemetry is stale."""


@pytest.fixture
def walker(trot: Path, virtual: Callable, host: Callable) -> Walker:
    made = Walker(PUPPER_V2, Policy.load(trot))
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    made.warm_up(Measurement(Telemetry(**zeros, pos=np.zeros(12), vel=np.zeros(12)), 0.0, 0.0))
    made.forward = 0.3
    return made


def walk_into(loop: ControlLoop, walker: Walker, disaster: Callable[[], object]) -> RobotFault:
    """Walk, let something happen, and go on walking; the fault that ended it."""
    with pytest.raises(RobotFault) as caught:
        walk_until(loop, walker, disaster)
    return caught.value


def walk_until(loop: ControlLoop, walker: Walker, disaster: Callable[[], object]) -> None:
    steps = 0

    def after_step(_: Measurement) -> None:
        nonlocal steps
        steps += 1
        if steps == STEPS_BEFORE:
            disaster()
        assert steps < STEPS_BEFORE + STEPS_AFTER, "walked on"

    loop.play(walker, Mode.WALK, after_step)


@pytest.mark.parametrize(("kind", "joint", "found"), SENSED, ids=[row[0] for row in SENSED])
def test_what_telemetry_shows_ends_in_idle(
    virtual: Callable, host: Callable, when: Callable, walker: Walker, kind: str, joint: str | None, found: set[str]
):
    pupper = virtual(currents=True)
    robot = host(pupper.port)
    index, broke = spec.JOINT_NAMES.index(joint) if joint else 0, 0.0

    def break_down() -> None:
        nonlocal broke
        broke = pupper.break_down(kind, index)

    if kind == "restart":
        time.sleep(BEFORE_RESTART)
    if kind == "lagging":  # the real limit: with a patient one, joints seen late look stuck first
        robot.limits = replace(robot.limits, telemetry_age=WIRE.safety.telemetry_age)
    robot.receive(time.monotonic() + 0.1)
    with pytest.raises(RobotFault) as caught:
        run(robot, lambda loop: walk_until(loop, walker, break_down))
    fault = caught.value
    assert fault.kind in found and fault.safe_state == "idle"
    assert joint is None or fault.kind in ("fall", "implausible telemetry") or joint in str(fault)
    idle = when(pupper, IDLE, broke)
    time.sleep(0.1)
    assert [event for at, event in pupper.events if at > idle] == [], "nothing moves it again"


@pytest.mark.parametrize("full", [False, True], ids=["a buffer that can be emptied", "a buffer that stays full"])
def test_a_robot_that_takes_no_more_bytes_is_said_and_idles_when_it_listens_again(
    virtual: Callable, host: Callable, when: Callable, monkeypatch: pytest.MonkeyPatch, full: bool
):
    """While it is told to stand still: a joint that is led somewhere would be stuck before.

    What the host cannot get rid of any more, the watchdog can.
    """
    pupper, steps = virtual(), 0
    robot = host(pupper.port)
    if full:
        monkeypatch.setattr("motorprior.hardware.serial_link.termios.tcflush", lambda *_: None)

    def stand(_: Measurement) -> np.ndarray | None:
        nonlocal steps
        steps += 1
        if steps == STEPS_BEFORE:
            pupper.break_down("deaf")
        return spec.NOMINAL_POSE if steps < 10 * STEPS_AFTER else None

    with pytest.raises(RobotFault, match="takes no more bytes") as caught:
        run(robot, lambda loop: loop.play(stand, Mode.WALK))
    assert caught.value.kind == "unplugged" and "by hand" in str(caught.value)
    assert (robot._port.unsent > 0) == full, "what this test is about"
    pupper._faults.clear()
    when(pupper, IDLE)


def test_the_firmware_giving_up_is_heard(virtual: Callable, host: Callable, stand_up: Callable, walker: Walker):
    """12 A, which a host without currents cannot see; the firmware can, and takes the current away by itself."""
    pupper = virtual()
    robot = host(pupper.port)
    fault = walk_into(stand_up(robot), walker, lambda: pupper.break_down("surge", 4))
    assert fault.kind == "firmware" and "ERROR" in str(fault)
    assert pupper.firmware.mode == ERROR


def test_unplugging_is_said_with_what_to_do(virtual: Callable, host: Callable, stand_up: Callable, walker: Walker):
    pupper = virtual()
    robot = host(pupper.port)
    fault = walk_into(stand_up(robot), walker, lambda: pupper.break_down("unplugged"))
    assert fault.kind == "unplugged" and "by hand" in str(fault)
    robot.idle()  # cannot reach it any more, and must not fail


def run(robot: RobotLink, work: Callable, stop: StopRequest | None = None) -> None:
    """`run_armed` with a watchdog that would be a minute late: it is not the one who makes the robot idle."""
    robot.limits = replace(robot.limits, watchdog=60.0)
    run_armed(robot, Gains.of(WIRE), stop or StopRequest(), work)


def slow(_: Measurement) -> None:
    time.sleep(0.1)


def test_a_slow_host_sits_down_and_idles(
    virtual: Callable, host: Callable, walker: Walker, when: Callable, sits: Callable
):
    pupper = virtual()
    robot = host(pupper.port)
    robot.limits = replace(robot.limits, tick_delay=0.09)

    def work(loop: ControlLoop) -> None:
        loop.play(walker, Mode.WALK, slow)

    with pytest.raises(RobotFault) as caught:
        run(robot, work)
    assert caught.value.kind == "slow host" and caught.value.safe_state == "crouch"
    when(pupper, IDLE)
    assert sits(pupper)


@pytest.mark.parametrize("error", [ValueError("a bug"), np.full(12, np.nan)], ids=["exception", "not finite"])
def test_an_error_in_the_program_sits_down_and_idles(
    virtual: Callable, host: Callable, when: Callable, sits: Callable, error: Exception | np.ndarray
):
    pupper = virtual()
    robot = host(pupper.port)

    def broken(_: Measurement) -> np.ndarray:
        if isinstance(error, Exception):
            raise error
        return error

    with pytest.raises((ValueError, RobotFault), match=r"a bug|not 12 finite angles"):
        run(robot, lambda loop: loop.play(broken, Mode.WALK))
    when(pupper, IDLE)
    assert sits(pupper)


def test_a_hanging_host_is_idled_by_the_watchdog(
    virtual: Callable, host: Callable, stand_up: Callable, walker: Walker, when: Callable
):
    """And when the host comes back it hears so, instead of walking on."""
    pupper = virtual()
    robot = host(pupper.port)
    hung_at = 0.0

    def hang() -> None:
        nonlocal hung_at
        hung_at = time.monotonic()
        when(pupper, IDLE, hung_at)

    robot.limits = replace(robot.limits, telemetry_age=float("inf"))
    loop = stand_up(robot)
    fault = walk_into(loop, walker, hang)
    assert fault.kind == "watchdog" and "silent" in str(fault)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "asleep"])
def test_the_death_of_the_watchdog_sits_down_and_idles(
    virtual: Callable, host: Callable, walker: Walker, when: Callable, sits: Callable, number: signal.Signals
):
    """Asleep, it is found when its pipe is full, after a second; nobody waits for it while the robot moves."""
    pupper = virtual()
    robot = host(pupper.port)
    steps = 0

    def after_step(_: Measurement) -> None:
        nonlocal steps
        steps += 1
        if steps == STEPS_BEFORE:
            assert robot._guardian is not None
            os.kill(robot._guardian.pid, number)

    with pytest.raises(RobotFault, match="watchdog process is dead"):
        run(robot, lambda loop: loop.play(walker, Mode.WALK, after_step))
    when(pupper, IDLE)
    assert sits(pupper)
    targets = [at for at, event in pupper.events if event == "target"]
    assert np.diff(targets).max() < 0.5, "targets never stop coming"


@pytest.mark.parametrize("number", STOPPING, ids=lambda number: number.name)
def test_a_signal_sits_down_and_idles(
    virtual: Callable, host: Callable, walker: Walker, when: Callable, sits: Callable, number: signal.Signals
):
    from motorprior.hardware.session import stop_on_signals

    pupper = virtual()
    robot = host(pupper.port)
    with stop_on_signals() as stop:
        timer = threading.Timer(1.3, lambda: os.kill(os.getpid(), number))
        timer.start()
        try:
            run(robot, lambda loop: loop.play(walker, Mode.WALK), stop)
        finally:  # a run that a fault ended before leaves no signal for pytest
            timer.cancel()
            timer.join()
    assert stop.reason == number.name
    when(pupper, IDLE)
    assert sits(pupper)


def test_many_signals_drop_the_robot_and_do_not_hinder_it(
    virtual: Callable, deploying: Callable, trot: Path, tmp_path: Path, when: Callable
):
    """Somebody who leans on Ctrl-C: the second one drops everything, the others change nothing."""
    pupper = virtual()
    walking = deploying(pupper.port, trot, tmp_path / "run")
    first = when(pupper, POSITION, patience=30.0)
    time.sleep(max(0.0, first + 1.5 - time.monotonic()))
    pressed = time.monotonic()
    while walking.poll() is None and time.monotonic() < pressed + 5.0:
        os.kill(walking.pid, signal.SIGINT)
        time.sleep(0.004)
    assert when(pupper, IDLE, pressed) - pressed < 0.5 and pupper.events[-1][1] == IDLE
    assert walking.wait(timeout=10.0) in (2, -signal.SIGINT)


@pytest.mark.parametrize(
    ("kind", "joint", "found"),
    [
        ("hot_motor", "FL_knee", "temperature"),
        ("flat", None, "battery"),
        ("numb", None, "frozen IMU"),
        ("blind", None, "frozen IMU"),
    ],
)
def test_what_leaves_time_sits_down_and_idles(
    virtual: Callable,
    host: Callable,
    walker: Walker,
    when: Callable,
    sits: Callable,
    kind: str,
    joint: str | None,
    found: str,
):
    pupper = virtual()
    robot = host(pupper.port)
    index = spec.JOINT_NAMES.index(joint) if joint else 0
    with pytest.raises(RobotFault) as caught:
        run(robot, lambda loop: walk_until(loop, walker, lambda: pupper.break_down(kind, index)))
    assert caught.value.kind == found and (joint is None or joint in str(caught.value))
    when(pupper, IDLE)
    assert sits(pupper)


@pytest.mark.parametrize("room", [0, 40_000])
def test_a_full_disk_sits_down_and_idles(
    virtual: Callable,
    host: Callable,
    walker: Walker,
    when: Callable,
    sits: Callable,
    tmp_path: Path,
    full_disk: Callable,
    room: int,
):
    """The disk is a limit of the file size here; without any room not even the header can be written."""
    pupper = virtual()
    robot = host(pupper.port, recorder=Recorder(PUPPER_V2, tmp_path / "run.csv"))
    with full_disk(room), pytest.raises(ArtifactError, match=r"run\.csv: cannot write"):
        run(robot, lambda loop: loop.play(walker, Mode.WALK))
    when(pupper, IDLE)
    assert sits(pupper)
    if room:
        assert read_robot_run(tmp_path / "run.csv", PUPPER_V2, (Mode.RAMP,)).num_rows > 10
