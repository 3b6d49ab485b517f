"""Every fault of the table in docs/hardware.md, in simulated time: it is reported, and the safe state reached.

The operating system's part, the port and the watchdog, is in test_watchdog.py.
"""

import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from robot_faults import FaultyPort

from full_disk import file_sizes_restored, limit_file_sizes
from motorprior.artifacts import read_json
from motorprior.exceptions import ArtifactError, RobotFault
from motorprior.hardware.commands import run_deploy, run_record
from motorprior.hardware.deploy import PolicyMotion
from motorprior.hardware.settings import DeploySettings, RecordSettings
from motorprior.hardware.virtual.firmware import ERROR, IDLE
from motorprior.logs.formats.robot_run import Mode, read_robot_run
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import on_its_clock

LIMITS = PUPPER_V2.require_wire().safety
DROP, SIT = 1.0, 8.0
"""[s] from a fault to an idle robot: dropped at once, or after coming to rest and sitting down."""


@dataclass
class Incident:
    """A walk and what ended it."""

    port: FaultyPort
    began: float = np.nan
    error: BaseException | None = None

    @property
    def reaction(self) -> float:
        return next(at for at, what in self.port.events if what == IDLE and at >= self.began) - self.began

    @property
    def sat(self) -> bool:
        """Whether it was in the pose in which losing current is soft when it lost it."""
        return bool(np.abs(self.port.pose_at_idle - spec.CROUCH_POSE).max() < 0.35)


@pytest.fixture
def walk_into(trot: Path, tmp_path: Path) -> Callable[..., Incident]:
    """Deploy, and let something happen half a second into the walk."""

    def walk(happens: Callable[[FaultyPort], object], currents: bool = False, seconds: float = 4.0) -> Incident:
        port = FaultyPort(PUPPER_V2, currents)
        incident = Incident(port)

        def show(text: str) -> None:
            if "m/s" in text and np.isnan(incident.began):
                incident.began = port.now
                happens(port)

        with on_its_clock(port):
            try:
                settings = DeploySettings(out=tmp_path / "run", seconds=seconds, forward=0.3, yes=True)
                run_deploy(PUPPER_V2, trot, "a port", settings, show)
            except (ArtifactError, RobotFault, ValueError) as error:
                incident.error = error
        assert port.events[-1][1] in (IDLE, ERROR), "nothing moves it again"
        return incident

    return walk


ROBOT_FAULTS = [
    ("frozen", "FR_knee", {"stuck"}, "idle"),
    ("jumping", "FL_hip", {"implausible telemetry"}, "idle"),
    ("stalled", "RR_knee", {"stuck", "tracking"}, "idle"),
    ("dead", "FR_knee", {"stuck", "tracking", "fall"}, "idle"),
    ("tilted", None, {"fall"}, "idle"),
    ("hot_current", "RL_hip", {"current"}, "idle"),
    ("mute", None, {"stale telemetry"}, "idle"),
    ("lagging", None, {"stale telemetry"}, "idle"),
    ("restart", None, {"implausible telemetry"}, "idle"),
    ("hot_motor", "FL_knee", {"temperature"}, "crouch"),
    ("flat", None, {"battery"}, "crouch"),
    ("numb", None, {"frozen IMU"}, "crouch"),
    ("blind", None, {"frozen IMU"}, "crouch"),
]


@pytest.mark.parametrize(("kind", "joint", "reported", "state"), ROBOT_FAULTS, ids=[row[0] for row in ROBOT_FAULTS])
def test_a_fault_of_the_robot_ends_in_its_safe_state(
    walk_into: Callable[..., Incident], tmp_path: Path, kind: str, joint: str | None, reported: set[str], state: str
):
    index = spec.JOINT_NAMES.index(joint) if joint else 0
    incident = walk_into(lambda port: port.inject(kind, index), currents=kind == "hot_current")
    fault = incident.error
    assert isinstance(fault, RobotFault) and fault.kind in reported and fault.safe_state == state
    assert joint is None or fault.kind in ("fall", "implausible telemetry") or joint in str(fault)
    assert incident.reaction < (DROP if state == "idle" else SIT)
    assert incident.sat == (state == "crouch")
    facts = read_json(tmp_path / "run" / "run.json")
    assert (facts["outcome"], facts["message"]) == (fault.kind, str(fault))
    assert facts["frames"]["accepted"] > 100 and facts["settings"]["forward"] == 0.3


def test_the_firmware_giving_up_is_reported(walk_into: Callable[..., Incident]):
    """12 A, which a host without currents cannot see; the firmware removes the current by itself."""
    incident = walk_into(lambda port: port.inject("surge", 4))
    assert isinstance(incident.error, RobotFault) and incident.error.kind == "firmware"
    assert incident.port.firmware.mode == ERROR


def raise_an_error(_: FaultyPort) -> None:
    raise ValueError("a bug")


HOST_FAULTS = [
    (lambda port: port.pause_host(LIMITS.tick_delay + 0.01), "slow host"),
    (raise_an_error, "program error"),
    (lambda _: limit_file_sizes(0), "recording"),
]


@pytest.mark.parametrize(("happens", "outcome"), HOST_FAULTS, ids=[row[1] for row in HOST_FAULTS])
def test_after_a_fault_of_the_host_the_robot_sits_down(
    walk_into: Callable[..., Incident], tmp_path: Path, happens: Callable, outcome: str
):
    with file_sizes_restored():
        incident = walk_into(happens)
    assert incident.error is not None and incident.sat and incident.reaction < SIT
    if outcome == "recording":
        assert read_robot_run(tmp_path / "run" / "run.csv", PUPPER_V2, (Mode.RAMP,)).num_rows > 10
    else:
        assert read_json(tmp_path / "run" / "run.json")["outcome"] == outcome


def test_targets_that_are_not_finite_are_not_sent(walk_into: Callable[..., Incident], monkeypatch: pytest.MonkeyPatch):
    def break_policy(_: FaultyPort) -> None:
        monkeypatch.setattr(PolicyMotion, "__call__", lambda *_: np.full(12, np.nan))

    incident = walk_into(break_policy)
    assert isinstance(incident.error, RobotFault) and incident.error.kind == "impossible command" and incident.sat


def test_a_pause_within_the_limit_is_ridden_out(walk_into: Callable[..., Incident], tmp_path: Path):
    incident = walk_into(lambda port: port.pause_host(LIMITS.tick_delay - 0.01), seconds=1.5)
    assert incident.error is None and incident.sat
    figures = read_json(tmp_path / "run" / "figures.json")
    assert figures["period_jitter_ms/max"] > 80.0 and figures["telemetry_age_ms/p99"] < 20.0
    assert read_json(tmp_path / "run" / "run.json")["outcome"] == "time"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_a_signal_sits_the_robot_down(walk_into: Callable[..., Incident], tmp_path: Path, number: signal.Signals):
    incident = walk_into(lambda _: signal.raise_signal(number))
    assert incident.error is None and incident.sat
    assert read_json(tmp_path / "run" / "run.json")["outcome"] == number.name


def test_a_second_signal_drops_the_robot_and_more_change_nothing(walk_into: Callable[..., Incident]):
    def press_often(_: FaultyPort) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)

    incident = walk_into(press_often)
    assert isinstance(incident.error, RobotFault) and incident.error.kind == "stopped" and incident.reaction < DROP


def test_a_fault_while_the_robot_sits_down_does_not_start_the_walk_again(
    walk_into: Callable[..., Incident], tmp_path: Path
):
    def stop_and_break(port: FaultyPort) -> None:
        signal.raise_signal(signal.SIGINT)
        port.inject("flat")

    incident = walk_into(stop_and_break)
    assert isinstance(incident.error, RobotFault) and incident.error.kind == "battery" and incident.sat
    modes = [int(row.split(",")[1]) for row in (tmp_path / "run" / "run.csv").read_text().splitlines()[1:]]
    assert modes == sorted(modes) and modes[-1] == Mode.CROUCH


def test_a_suspended_robot_does_not_crouch(tmp_path: Path):
    port = FaultyPort(PUPPER_V2, suspended=True)
    with on_its_clock(port):
        run_record(PUPPER_V2, "a port", RecordSettings(tmp_path / "run", "sine", seconds=1.0, yes=True), print)
    assert port.events[-1][1] == IDLE and np.abs(port.pose_at_idle - spec.CROUCH_POSE).max() > 0.35


def test_clipped_targets_are_counted(
    trot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walk_into: Callable[..., Incident]
):
    """Thirty control steps with a target beyond an end stop, and a warm-up step."""
    walk, steps = PolicyMotion.__call__, 0

    def beyond(self: PolicyMotion, measurement) -> np.ndarray:
        nonlocal steps
        steps += 1
        return np.where((np.arange(12) == 3) & (1 < steps <= 31), 9.0, walk(self, measurement))

    monkeypatch.setattr(PolicyMotion, "__call__", beyond)
    walk_into(lambda _: None, seconds=0.8)
    facts = read_json(tmp_path / "run" / "run.json")
    assert facts["position_clips"] == 30 and facts["slew_clips"] >= 1
