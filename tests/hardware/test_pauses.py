"""A host that stands still for a moment while its robot walks, in simulated time: ridden out up to the bound."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hardware_stalls import BEGIN, SPREAD, StallingPort

from motorprior.exceptions import RobotFault
from motorprior.hardware.commands import run_deploy
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.deploy import gains_for, walk
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


def test_telemetry_that_pauses_for_longer_than_its_bound_ends_the_walk(paused: Callable):
    assert paused(LIMITS.telemetry_age - 0.03, "blind")[1] is None
    fault = paused(LIMITS.telemetry_age + 0.03, "blind")[1]
    assert fault is not None and fault.kind == "stale telemetry" and fault.safe_state == "idle"
