"""Virtual Puppers at real pseudo-terminals, and hosts that drive them."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policies import as_file_content

from full_disk import file_sizes_restored, limit_file_sizes
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.motions import ramp
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.servo_law import servo_current
from motorprior.hardware.session import Gains
from motorprior.hardware.virtual.firmware import IDLE, Drive, Sensors
from motorprior.hardware.virtual.virtual_robot import VirtualRobot, in_thread
from motorprior.locomotion.policy import zero_policy
from motorprior.logs.formats.robot_run import Mode
from motorprior.pipeline.virtual.virtual_robot import Virtual, make
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.wire import SafetyLimits

WIRE = PUPPER_V2.require_wire()
PATIENT = replace(
    WIRE.safety,
    slow_speed=4.0,
    tick_delay=float("inf"),
    late_ticks=100,
    stalled_time=float("inf"),
    telemetry_age=0.5,
    watchdog=0.5,
)
"""Limits for a machine that has other things to do, and for tests in a hurry: quick ramps. The real ones are tested
without a clock in test_safety.py, and measured by benchmarks/hardware.py."""
BARE = [sys.executable, str(Path(__file__).with_name("bare_environment.py")), "motorprior.hardware"]
"""The command line of the robot's computer, without numba, safetensors, tyro and all the rest."""
QUIET = 0.15
"""Time for the first frames [s]."""


@pytest.fixture(scope="session")
def trot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy of zero weights: it trots as it is told and stays on its feet."""
    path = tmp_path_factory.mktemp("policy") / "policy.safetensors"
    as_file_content(zero_policy(12)).save(path)
    return path


class _Events(list):
    """What a virtual robot goes through, and its joint angles [rad] when it lost its current.

    Afterwards it sinks, for as long as a busy machine takes to look.
    """

    def __init__(self, robot: VirtualRobot):
        super().__init__()
        self._robot, self.limp = robot, np.full(12, np.nan)

    def append(self, event: tuple[float, str]) -> None:
        super().append(event)
        if event[1] == IDLE:
            self.limp = self._robot.firmware._sensors.pos * spec.JOINT_SIGNS


@pytest.fixture
def virtual() -> Iterator[Callable[..., VirtualRobot]]:
    """Start a virtual Pupper that holds its pose at once, in a thread; all end with the test."""
    ends = []

    def start(**settings) -> VirtualRobot:
        robot, body = make(PUPPER_V2, Virtual(**{"homing": False, **settings}))
        robot.body = body  # pyright: ignore[reportAttributeAccessIssue]  # for the truth
        robot.events = _Events(robot)
        ends.append(in_thread(robot))
        return robot

    yield start
    for end in ends:
        end()


@pytest.fixture
def host() -> Iterator[Callable[..., RobotLink]]:
    """A host's side of a port; idle when the test ends."""
    with ExitStack() as stack:

        def connect(port: str, **settings) -> RobotLink:
            made = RobotLink(PUPPER_V2, SerialLink(PUPPER_V2, port), **{"limits": PATIENT, **settings})
            stack.callback(made.close)
            made.receive(time.monotonic() + QUIET)
            return made

        yield connect


def _stand_up(robot: RobotLink, stop: Callable[[], bool] = lambda: False) -> ControlLoop:
    """Arm and ramp to the nominal pose, a little faster than a person would."""
    gains = Gains.of(WIRE)
    robot.arm(gains.kp, gains.kd, gains.max_current)
    loop = ControlLoop(robot, robot.limits, spec.CONTROL_DT, stop)
    target = robot.target
    assert target is not None
    loop.play(ramp(target, spec.NOMINAL_POSE, robot.limits.slow_speed, spec.CONTROL_DT), Mode.RAMP)
    return loop


def _when(robot: VirtualRobot, what: str, after: float = 0.0, patience: float = 3.0) -> float:
    """The first time [s, monotonic] after ``after`` at which the robot entered a mode."""
    give_up = time.monotonic() + patience
    while time.monotonic() < give_up:
        times = [at for at, event in list(robot.events) if event == what and at >= after]
        if times:
            return times[0]
        time.sleep(0.005)
    raise AssertionError(f"never {what}: {[event for _, event in robot.events][-5:]}")


def _deploying(port: str, policy: Path, out: Path, *options: str) -> subprocess.Popen:
    """`deploy` in a process of its own that has what the robot's computer has."""
    return subprocess.Popen(
        [*BARE, "deploy", str(policy), "--port", port, "--out", str(out), "--yes", *options],
        stdin=subprocess.DEVNULL,  # nobody steers: it walks
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def stand_up() -> Callable[..., ControlLoop]:
    """See `_stand_up`."""
    return _stand_up


@pytest.fixture
def when() -> Callable[..., float]:
    """See `_when`."""
    return _when


@pytest.fixture
def sits() -> Callable[[VirtualRobot], bool]:
    """Whether a robot was about in the pose in which losing current is soft when it lost it."""
    return lambda pupper: bool(np.abs(pupper.events.limp - spec.CROUCH_POSE).max() < 0.35)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.fixture
def deploying() -> Iterator[Callable[..., subprocess.Popen]]:
    """See `_deploying`; whatever still runs is killed."""
    started = []

    def start(*arguments, **options) -> subprocess.Popen:
        started.append(_deploying(*arguments, **options))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        with suppress(subprocess.TimeoutExpired):  # its watchdog holds its stderr, too
            process.communicate(timeout=30.0)


@pytest.fixture
def full_disk() -> Callable[[int], AbstractContextManager]:
    """While this is open, no file grows beyond so many bytes."""

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        with file_sizes_restored():
            limit_file_sizes(size)
            yield

    return limited


@pytest.fixture
def patient_limits() -> SafetyLimits:
    """See PATIENT."""
    return PATIENT


@pytest.fixture
def bare_command() -> list[str]:
    """See BARE."""
    return BARE


@pytest.fixture
def still_body() -> "StillBody":
    """A body for firmware alone."""
    return StillBody()


class StillBody:
    """Joints that follow their targets like a first-order low-pass of kd/kp; no ground, no weight."""

    def __init__(self):
        self.pos, self.vel, self.drive = spec.JOINT_SIGNS * spec.NOMINAL_POSE, np.zeros(12), None

    def advance(self, milliseconds: int, drive: Drive) -> None:
        self.drive = drive
        before = self.pos.copy()
        rate = drive.kp / np.where(drive.kd > 0.0, drive.kd, 1.0)
        self.pos = self.pos + (1.0 - np.exp(-1e-3 * milliseconds * rate)) * (drive.target - self.pos)
        self.vel = (self.pos - before) / (1e-3 * max(1, milliseconds))

    def sense(self) -> Sensors:
        drive = self.drive
        current = np.zeros(12)
        if drive is not None:
            current = servo_current(drive.target, self.pos, self.vel, drive.kp, drive.kd, drive.max_current)
        return Sensors(self.pos.copy(), self.vel.copy(), current, np.full(3, 1e-3), np.zeros(3))
