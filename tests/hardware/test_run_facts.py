"""What a run leaves beside its recording says how it ended and under which limits, whatever ended it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import read_json
from motorprior.exceptions import RobotFault
from motorprior.hardware.commands import run_deploy
from motorprior.hardware.settings import DeploySettings
from motorprior.hardware.virtual.virtual_robot import VirtualRobot
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits


@pytest.fixture
def patient(patient_limits: SafetyLimits) -> Robot:
    """The commands take the robot's own limits; this machine has other things to do."""
    return replace(PUPPER_V2, wire=replace(PUPPER_V2.require_wire(), safety=patient_limits))


def walk_into(robot: Robot, pupper: VirtualRobot, kind: str, trot: Path, out: Path) -> None:
    """Deploy, and let something break at the first line of status."""

    def say(text: str) -> None:
        if "m/s" in text:
            pupper.break_down(kind)

    run_deploy(robot, trot, pupper.port, DeploySettings(out=out, seconds=6.0, yes=True), say)


@pytest.mark.parametrize(("kind", "outcome"), [("tilted", "fall"), ("numb", "frozen IMU"), ("unplugged", "unplugged")])
def test_a_fault_that_ended_a_run_stands_in_its_facts(
    patient: Robot, virtual: Callable, trot: Path, tmp_path: Path, kind: str, outcome: str
):
    with pytest.raises(RobotFault) as caught:
        walk_into(patient, virtual(), kind, trot, tmp_path)
    facts, figures = read_json(tmp_path / "run.json"), read_json(tmp_path / "figures.json")
    assert (facts["outcome"], facts["message"]) == (outcome, str(caught.value))
    assert facts["command"] == "deploy" and facts["settings"]["seconds"] == 6.0 and facts["ended"] >= facts["started"]
    assert figures["control_steps"] >= 50 and facts["commands"] > figures["control_steps"]
    assert facts["frames"]["believed"] > 100
    machine = facts["machine"]
    assert machine["timer_wakes"] > 100 and machine["timer_late_ms/p50"] <= machine["timer_late_ms/max"]
    assert isinstance(machine["memory_locked"], bool) and isinstance(machine["real_time_priority"], bool)


def test_a_run_that_ended_in_time_says_so_and_counts_its_clips(
    patient: Robot, virtual: Callable, trot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Thirty control steps in which a joint is told to go beyond its end stop."""
    from motorprior.hardware.motions import Walker

    walk, steps = Walker.__call__, 0

    def beyond(self: Walker, measurement) -> np.ndarray:
        nonlocal steps
        steps += 1
        return np.where((np.arange(12) == 3) & (1 < steps <= 31), 9.0, walk(self, measurement))

    monkeypatch.setattr(Walker, "__call__", beyond)
    run_deploy(patient, trot, virtual().port, DeploySettings(out=tmp_path, seconds=0.8, yes=True), lambda _: None)
    facts = read_json(tmp_path / "run.json")
    assert (facts["outcome"], facts["message"]) == ("time", None)
    assert facts["position_clips"] == 30 and facts["slew_clips"] >= 1
