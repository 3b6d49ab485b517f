"""Every fault of the table in docs/hardware.md, in simulated time.

Faults of the operating system are in test_watchdog.py.
"""

import os
import pty
import resource
import select
import signal
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from robot_faults import FaultyPort

from motorprior.artifacts import read_json
from motorprior.exceptions import ArtifactError, RobotFault
from motorprior.hardware.motions import PolicyMotion
from motorprior.hardware.protocol import Command, framed
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.runs import deploy, diagnose, record
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.session import Check, check_before_arming, check_telemetry
from motorprior.hardware.settings import DeploySettings, RunSettings
from motorprior.hardware.virtual_robot import ERROR, IDLE
from motorprior.logs.readers.deploy_recording import Mode, read_deploy_recording
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from noise import noisy_walk
from simulated_port import SimulatedPort, on_its_clock

LIMITS = PUPPER_V2.require_wire().safety
MAX_REACTION = {"idle": 1.0, "crouch": 8.0}  # [s] from a fault to an idle robot


@dataclass
class Incident:
    """A walk with a fault: when the fault began, and the error that ended the walk."""

    port: FaultyPort
    began: float = np.nan
    error: BaseException | None = None

    @property
    def reaction(self) -> float:
        """Time from the fault to the first idle command [s]."""
        idle_times = [at for at, event in self.port.events if event == IDLE and at >= self.began]
        return idle_times[0] - self.began

    @property
    def crouched(self) -> bool:
        """Whether it was in the crouch pose when it lost its current."""
        distance = np.abs(self.port.pose_at_idle - PUPPER_V2.require_wire().crouch_pose)
        return bool(distance.max() < 0.35)


def fill_disk(port: FaultyPort) -> None:
    """Limit all files of this process to 0 bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


@contextmanager
def full_disk_ends() -> Iterator[None]:
    """Context in which writes to a full disk fail and do not kill the process.

    On exit the disk is no longer full.
    """
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.fixture
def walk_into(trot: Path, tmp_path: Path) -> Callable[..., Incident]:
    """Function that deploys a policy and calls ``happens`` as soon as it walks."""

    def walk(
        happens: Callable[[FaultyPort], object], currents: bool = False, seconds: float = 4.0
    ) -> Incident:
        port = FaultyPort(PUPPER_V2, currents)
        incident = Incident(port)
        settings = DeploySettings(out=tmp_path / "run", seconds=seconds, forward=0.3, yes=True)

        def show(text: str) -> None:
            if "m/s" in text and np.isnan(incident.began):
                incident.began = port.now
                happens(port)

        with on_its_clock(port), full_disk_ends():
            try:
                deploy(PUPPER_V2, trot, "a port", settings, show)
            except (ArtifactError, RobotFault, ValueError) as error:
                incident.error = error
            finally:
                mock.patch.stopall()
        assert port.events[-1][1] in (IDLE, ERROR), "nothing moves it again"
        return incident

    return walk


def inject(fault: str, joint: str = "FR_hip") -> Callable[[FaultyPort], object]:
    index = PUPPER_V2.joint_names.index(joint)
    return lambda port: port.inject(fault, index)


def send_signal(number: signal.Signals) -> Callable[[FaultyPort], object]:
    return lambda _: signal.raise_signal(number)


def raise_an_error(_: FaultyPort) -> None:
    raise ValueError("a bug")


def break_policy(_: FaultyPort) -> None:
    mock.patch.object(PolicyMotion, "__call__", lambda *_: np.full(12, np.nan)).start()


FAULTS = {
    "frozen encoder": (inject("frozen", "FR_knee"), {"stuck"}, "idle"),
    "jumping encoder": (inject("jumping", "FL_hip"), {"implausible telemetry"}, "idle"),
    "blocked joint": (inject("stalled", "RR_knee"), {"stuck", "tracking"}, "idle"),
    "motor without power": (inject("dead", "FR_knee"), {"stuck", "tracking", "fall"}, "idle"),
    "fall": (inject("tilted"), {"fall"}, "idle"),
    "overcurrent": (inject("hot_current", "RL_hip"), {"current"}, "idle"),
    "telemetry stops": (inject("telemetry_stops"), {"stale telemetry"}, "idle"),
    "telemetry grows late": (inject("telemetry_late"), {"stale telemetry"}, "idle"),
    "robot restarts": (inject("restart"), {"implausible telemetry"}, "idle"),
    "IMU repeats its values": (inject("imu_repeats"), {"frozen IMU"}, "crouch"),
    "IMU sends zeros": (inject("imu_zeros"), {"frozen IMU"}, "crouch"),
    "slow host": (lambda port: port.pause_host(LIMITS.tick_delay + 0.01), {"slow host"}, "crouch"),
    "targets are not finite": (break_policy, {"impossible command"}, "crouch"),
    "exception": (raise_an_error, {"program error"}, "crouch"),
    "disk full": (fill_disk, {"recording"}, "crouch"),
    "SIGINT": (send_signal(signal.SIGINT), {"SIGINT"}, "crouch"),
    "SIGTERM": (send_signal(signal.SIGTERM), {"SIGTERM"}, "crouch"),
    "SIGHUP": (send_signal(signal.SIGHUP), {"SIGHUP"}, "crouch"),
    "SIGTSTP": (send_signal(signal.SIGTSTP), {"SIGTSTP"}, "crouch"),
}
"""Cause, names that the fault may have, and safe state in which it ends."""


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_reported_and_ends_in_its_safe_state(
    walk_into: Callable[..., Incident], tmp_path: Path, name: str
):
    happens, fault_names, safe_state = FAULTS[name]

    incident = walk_into(happens, currents=name == "overcurrent")

    assert incident.reaction < MAX_REACTION[safe_state]
    assert incident.crouched == (safe_state == "crouch")
    if isinstance(incident.error, RobotFault):
        assert incident.error.name in fault_names
        assert incident.error.safe_state == safe_state

    if name == "disk full":
        recording = tmp_path / "run" / "run.csv"
        assert read_deploy_recording(recording, PUPPER_V2, (Mode.RAMP,)).num_rows > 10
        return
    run = read_json(tmp_path / "run" / "run.json")
    assert run["outcome"] in fault_names
    assert run["frames"]["accepted"] > 100
    assert run["settings"]["forward"] == 0.3
    assert run["message"] == (None if incident.error is None else str(incident.error))


def test_an_error_of_the_firmware_is_reported(walk_into: Callable[..., Incident]):
    """A host without currents cannot detect 12 A; the firmware removes the current by itself."""
    incident = walk_into(inject("surge"))

    assert isinstance(incident.error, RobotFault)
    assert incident.error.name == "firmware"
    assert incident.port.firmware.mode == ERROR


def test_after_a_pause_within_the_limit_the_robot_walks_on(
    walk_into: Callable[..., Incident], tmp_path: Path
):
    incident = walk_into(lambda port: port.pause_host(LIMITS.tick_delay - 0.01), seconds=1.5)

    assert incident.error is None
    assert incident.crouched
    figures = read_json(tmp_path / "run" / "figures.json")
    assert figures["period_jitter_ms/max"] > 80.0
    assert figures["telemetry_age_ms/p99"] < 20.0
    assert read_json(tmp_path / "run" / "run.json")["outcome"] == "time"


def test_a_second_signal_drops_the_robot_and_more_change_nothing(
    walk_into: Callable[..., Incident],
):
    def press_often(_: FaultyPort) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGINT)

    incident = walk_into(press_often)

    assert isinstance(incident.error, RobotFault)
    assert incident.error.name == "stopped"
    assert incident.reaction < MAX_REACTION["idle"]


def test_a_fault_during_the_crouch_does_not_start_the_walk_again(
    walk_into: Callable[..., Incident], tmp_path: Path
):
    def stop_and_break(port: FaultyPort) -> None:
        signal.raise_signal(signal.SIGINT)
        port.inject("imu_repeats")

    incident = walk_into(stop_and_break)

    assert isinstance(incident.error, RobotFault)
    assert incident.error.name == "frozen IMU"
    assert incident.crouched
    _, *rows = (tmp_path / "run" / "run.csv").read_text().splitlines()
    modes = [int(row.split(",")[1]) for row in rows]
    assert modes == sorted(modes)
    assert modes[-1] == Mode.CROUCH


def test_a_suspended_robot_does_not_crouch(tmp_path: Path):
    port = FaultyPort(PUPPER_V2, suspended=True)
    with on_its_clock(port):
        settings = RunSettings(tmp_path / "run", yes=True)
        targets = np.tile(PUPPER_V2.nominal_pose, (100, 1))
        record(PUPPER_V2, "p", settings, targets, print, max_speed=8.0)

    assert port.events[-1][1] == IDLE
    assert not Incident(port).crouched


def test_a_robot_walks_on_when_three_percent_of_the_frames_are_lost_and_three_damaged(trot: Path):
    walk = noisy_walk(trot, 0.03, 30.0, 0)

    assert walk.fault is None
    assert walk.seconds == pytest.approx(30.0, abs=0.1)
    assert walk.path > 5.0  # [m]


def test_gains_are_sent_with_the_first_targets_only():
    """A gain or current limit that is repeated while the robot walks may be damaged."""
    port = SimulatedPort(PUPPER_V2, 0)
    with (
        on_its_clock(port),
        RobotLink(PUPPER_V2, port) as link,
        mock.patch.object(port, "send", wraps=port.send) as send,
    ):
        link.receive(0.1)
        link.arm(Gains.of(PUPPER_V2.require_wire()))
        for _ in range(20):
            link.send(PUPPER_V2.nominal_pose, Mode.RAMP)
            link.receive(port.now + 0.01)
        commands = [call.args[0] for call in send.call_args_list]

    has_gains = [command.kp is not None for command in commands]
    assert has_gains == 3 * [True, False] + 17 * [False]


def checked(port: FaultyPort, need_imu: bool = True) -> None:
    """Check the robot before arming, without a command to it."""
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        check_before_arming(link, need_imu)
        assert not port.events, "nothing was sent"


def get_up(port: FaultyPort) -> None:
    pose = PUPPER_V2.require_wire().joint_signs * PUPPER_V2.nominal_pose
    port.firmware.receive(framed(Command(pos=pose), 12))


REFUSED = {
    "IMU": lambda port: port.inject("imu_zeros"),
    "fall": lambda port: port.inject("tilted"),
    "stale telemetry": lambda port: port.inject("telemetry_stops"),
    "moving": get_up,
}


@pytest.mark.parametrize("fault_name", REFUSED)
def test_a_robot_with_a_fault_is_not_armed(fault_name: str):
    port = FaultyPort(PUPPER_V2)
    REFUSED[fault_name](port)

    with pytest.raises(RobotFault) as refused:
        checked(port)

    assert refused.value.name == fault_name


def test_a_robot_without_an_imu_is_armed_where_none_is_needed():
    port = FaultyPort(PUPPER_V2)
    port.inject("imu_zeros")
    checked(port, need_imu=False)


@pytest.mark.parametrize("period", [10, 5])
def test_telemetry_as_fast_as_the_control_period_is_accepted(period: int):
    checked(FaultyPort(PUPPER_V2, period=period))


def test_telemetry_slower_than_the_control_period_is_rejected():
    with pytest.raises(RobotFault, match="PRINT_DELAY"):
        checked(FaultyPort(PUPPER_V2, period=15))


def diagnosed(port: FaultyPort) -> dict[str, Check]:
    """Checks of the doctor by name."""
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        return {check.name: check for check in check_telemetry(link, 1.0)}


def test_the_doctor_finds_no_fault_in_a_healthy_robot():
    checks = diagnosed(FaultyPort(PUPPER_V2, currents=True))
    assert checks
    assert all(check.ok for check in checks.values())


def test_the_doctor_finds_faults_with_their_remedies():
    port = FaultyPort(PUPPER_V2, currents=True, corrupt=0.2)
    for fault in ("imu_zeros", "hot_current"):
        port.inject(fault, 4)

    checks = diagnosed(port)

    failed = {name: check for name, check in checks.items() if not check.ok}
    assert set(failed) == {"IMU", "damaged frames", "current"}
    assert all(check.remedy for check in failed.values())


def test_the_doctor_finds_telemetry_that_stopped():
    port = FaultyPort(PUPPER_V2)
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        port.faults["telemetry_stops"] = port.now + 0.3, 0
        checks = {check.name: check for check in check_telemetry(link, 1.0)}
    assert not checks["telemetry"].ok


@pytest.mark.real_time
def test_an_unknown_device_is_sent_nothing():
    master, slave = pty.openpty()
    tty.setraw(slave)

    with pytest.raises(RobotFault) as refused:
        diagnose(PUPPER_V2, os.ttyname(slave), 1.0, True, print)

    assert refused.value.name == "stale telemetry"
    assert not select.select([master], [], [], 0.1)[0]
    os.close(master)
    os.close(slave)
