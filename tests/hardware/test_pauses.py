"""A host that stands still for a moment while its robot walks, in simulated time: ridden out up to the bound."""

import itertools
import math
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware_stalls import BEGIN, SPREAD, StallingPort, bounds, main, trial
from motorprior.artifacts import read_json
from motorprior.exceptions import RobotFault
from motorprior.hardware.commands import run_deploy
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import StopRequest
from motorprior.hardware.settings import DeploySettings
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import SimulatedPort, on_its_clock

LIMITS = PUPPER_V2.require_wire().safety


@pytest.fixture
def paused(trot: Path) -> Callable[..., tuple[Timing, RobotFault | None]]:
    """Walk for some seconds with the robot's own limits; the host pauses once, or at every tenth step."""

    def run(pause: float, kind: str = "on") -> tuple[Timing, RobotFault | None]:
        policy, timing = Policy.load(trot), Timing()
        port = StallingPort(PUPPER_V2, 0, 0, pause, kind)
        with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
            try:
                gains = gains_for(PUPPER_V2, policy)
                walk(link, policy, gains, StopRequest(), command=(0.3, 0.0), seconds=5.0, timing=timing)
            except RobotFault as fault:
                return timing, fault
        return timing, None

    return run


def test_a_pause_within_the_bound_is_ridden_out(paused: Callable):
    """Telemetry that waited is read, and the latest of it is fresh; the steps left out stay left out."""
    timing, fault = paused(LIMITS.tick_delay - 0.01)
    assert fault is None
    assert max(timing.late) > LIMITS.tick_delay - 0.02 and timing.skipped >= 8
    assert max(timing.age[step] for step in range(len(timing.age)) if timing.late[step] < 0.005) < 0.02


class _AllStoodStill(SimulatedPort):
    """The whole machine stands still while the host waits, once, until 2 ms before a frame; what came is lost."""

    paused = 0.0

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        if self.paused or self.now < BEGIN:
            return super().wait(until)
        before, self.now = self.now, 0.01 * math.ceil(100.0 * self.now) + 0.078
        self.paused = self.now - before
        super().wait(self.now)
        return []


def test_a_host_that_wakes_up_waits_for_no_more_than_a_fresh_frame(trot: Path):
    policy, timing, port = Policy.load(trot), Timing(), _AllStoodStill(PUPPER_V2, 0)
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        gains = gains_for(PUPPER_V2, policy)
        walk(link, policy, gains, StopRequest(), command=(0.3, 0.0), seconds=5.0, timing=timing)
    assert 0.078 <= port.paused <= 0.088 and max(timing.late) < port.paused + 0.004


@pytest.mark.parametrize(("pause", "ended"), [(0.04, None), (0.06, "slow host")])
def test_a_shorter_pause_may_be_asked_for(trot: Path, tmp_path: Path, pause: float, ended: str | None):
    port = StallingPort(PUPPER_V2, 0, 0, pause, "on")
    settings = DeploySettings(out=tmp_path, seconds=5.0, forward=0.3, longest_pause=0.05, yes=True)
    with on_its_clock(port), pytest.raises(RobotFault) if ended else nullcontext() as caught:
        run_deploy(PUPPER_V2, trot, "a port", settings, lambda _: None)
    assert port.first < port.now and (caught is None or caught.value.kind == ended)


@pytest.mark.parametrize(("longest", "warned"), [(None, True), (0.05, False)])
def test_deploy_warns_of_a_policy_that_nothing_pushed(trot: Path, tmp_path: Path, longest: float | None, warned: bool):
    path, said = tmp_path / "policy.safetensors", []
    replace(Policy.load(trot), provenance={"randomization": {"push": 0.0}}).save(path)
    settings = DeploySettings(out=tmp_path / "run", seconds=0.1, longest_pause=longest, yes=True)
    with on_its_clock(SimulatedPort(PUPPER_V2, 0)):
        run_deploy(PUPPER_V2, path, "a port", settings, said.append)
    assert any("trained without pushes" in line for line in said) == warned


def test_a_pause_beyond_the_bound_ends_the_walk(paused: Callable):
    timing, fault = paused(LIMITS.tick_delay + 0.01)
    assert fault is not None and fault.kind == "slow host" and fault.safe_state == "crouch"
    assert timing.sent[-1] < BEGIN + SPREAD + 0.2


def test_pauses_within_the_bound_that_do_not_end_are_a_fault(paused: Callable):
    _, fault = paused(0.5 * LIMITS.tick_delay, "often")
    assert fault is not None and fault.kind == "slow host" and "in all" in str(fault)


def test_telemetry_that_pauses_for_longer_than_its_bound_ends_the_walk(paused: Callable):
    assert paused(LIMITS.telemetry_age - 0.03, "blind")[1] is None
    fault = paused(LIMITS.telemetry_age + 0.03, "blind")[1]
    assert fault is not None and fault.kind == "stale telemetry" and fault.safe_state == "idle"


def test_the_watchdog_waits_for_the_longest_pause_and_little_more():
    silence = LIMITS.tick_delay + PUPPER_V2.control_dt
    assert silence < LIMITS.watchdog <= silence + 0.02


def test_the_benchmark_tells_a_robot_that_falls(trot: Path, monkeypatch: pytest.MonkeyPatch):
    policy = Policy.load(trot)
    for kind in ("on", "down"):
        upright, speed = trial(policy, 0, 0, 0.1, kind, 0.3)
        assert upright and 0.15 < speed < 0.45, "a robot that stands proves nothing"
    monkeypatch.setattr("hardware_stalls.bounds", lambda *given: replace(bounds(*given), max_tilt=0.02))
    assert not trial(policy, 0, 0, 0.1, "on", 0.3)[0], "every walk leans so far"


class _Waiting:
    """A port at which batches of messages wait, as many as one read takes each."""

    rejected = unsent = 0

    def __init__(self, batches: Iterable[list[Telemetry | str]]):
        self._batches = iter(batches)

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        return [(time.monotonic(), message) for message in next(self._batches, [])]


def frames(count: int, hot: range = range(0)) -> list[Telemetry]:
    """One every 10 ms, with 9.5 A in those of ``hot``."""
    zeros = dict.fromkeys(("yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    return [
        Telemetry(**zeros, ts=10.0 * number, pos=np.zeros(12), vel=np.zeros(12), cur=np.full(12, 9.5 * (number in hot)))
        for number in range(count)
    ]


def test_telemetry_that_waited_is_read_to_its_end():
    """One read takes 4 kB: after a long pause the first ones are old."""
    waiting = frames(60)
    link = RobotLink(PUPPER_V2, _Waiting(waiting[first : first + 12] for first in range(0, 60, 12)))  # pyright: ignore[reportArgumentType]
    link.receive(time.monotonic() - 1.0)
    assert link.stream.latest is not None and link.stream.latest.telemetry is not None
    assert link.stream.latest.telemetry.ts == 590.0 and link.stream.accepted == 60


def test_a_device_that_sends_without_end_is_not_listened_to_without_end():
    link = RobotLink(PUPPER_V2, _Waiting(itertools.repeat(["a line"])))  # pyright: ignore[reportArgumentType]
    link.receive(time.monotonic() - 1.0)
    assert 1 <= len(link.text) <= 100


def test_a_fault_in_telemetry_that_waited_is_seen():
    """The last frame of it is well again."""
    limits = replace(LIMITS, telemetry_age=math.inf)
    link = RobotLink(PUPPER_V2, _Waiting([frames(12, range(3, 8))]), limits)  # pyright: ignore[reportArgumentType]
    link.receive(time.monotonic() - 1.0)
    with pytest.raises(RobotFault, match=r"draws -?9\.5 A"):
        link.check()


@pytest.mark.slow
def test_the_benchmark_tells_of_every_length(trot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "stalls.json"
    words = f"hardware_stalls --policy {trot} --kinds on blind --stalls 20 100 --draws 1 --json {out}"
    monkeypatch.setattr(sys, "argv", words.split())
    main()
    found = read_json(out)
    assert found["on/longest_ms"] == 20.0 and found["on/100"] < 0.8 and found["blind/longest_ms"] == 100.0
    assert 0.3 < found["on/speed"] < 0.5
