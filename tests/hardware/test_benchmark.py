"""The benchmark of deployment keeps what it measured when a part of it fails."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hardware_reactions
from hardware import measure, parts, trot_policy
from hardware_reactions import (
    FAULT_AT,
    FAULTS,
    HOST_FAULTS,
    MOST_FAULTS,
    WORDS,
    NotMeasuredError,
    host_reaction,
    is_meant,
    outcome,
    reaction,
)
from motorprior.exceptions import RobotFault
from motorprior.hardware.machine import MachineReport
from motorprior.hardware.virtual.injected import KINDS
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def test_a_part_that_fails_costs_no_other_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    def busy() -> dict[str, float]:
        (tmp_path / WORDS).write_text("robot fault 'slow host'\n")
        raise NotMeasuredError("this machine is too busy")

    found: dict[str, float] = {}
    wanted = {"one": lambda: {"one": 1.0}, "busy": busy, "two": lambda: {"two": 2.0}}
    assert measure(tmp_path, wanted, found.update) == ["busy"] and found == {"one": 1.0, "two": 2.0}
    said = capsys.readouterr().err
    assert "not measured: busy: this machine is too busy" in said and "robot fault 'slow host'" in said


def test_every_fault_is_a_part_of_its_own(tmp_path: Path):
    names = parts(tmp_path, trot_policy(PUPPER_V2, tmp_path), 60.0)
    faults = [fault.partition(":")[0] for fault in FAULTS] + [*HOST_FAULTS, "SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP"]
    assert [fault for fault in faults if f"reaction_ms/{fault}" not in names] == []
    assert "inference_ms/share_over_1ms" in names["inference"]()


class Walks:
    """Walks of a host that end one after the other as told, each 40 ms after the fault; the robot is idle at 70 ms."""

    def __init__(self, endings: list[Exception]):
        self.left = list(endings)

    @contextmanager
    def virtual_robot(self, folder: Path, *options: str) -> Iterator[tuple[str, Callable[[], dict]]]:
        now = time.monotonic()
        yield "port", lambda: {"started": now - FAULT_AT, "modes": [(now + 0.07, "idle"), (now + 9.0, "idle")]}

    def deploy(
        self, port: str, policy: Policy, seconds: float, log: Any = None, timing: Any = None, status: Any = None
    ):
        if status is not None:
            for _ in range(hardware_reactions.STATUS_BEFORE):
                status(None)
        time.sleep(0.04)
        if timing is not None:  # its last command left 0.2 s ago
            timing.ended, timing.fault = time.monotonic(), getattr(self.left[0], "kind", "")
            timing.sent.extend([timing.ended - 0.21, timing.ended - 0.2])
        raise self.left.pop(0)


@pytest.fixture
def walks(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Walks]:
    def ending(*endings: Exception) -> Walks:
        made = Walks(list(endings))
        monkeypatch.setattr(hardware_reactions, "virtual_robot", made.virtual_robot)
        monkeypatch.setattr(hardware_reactions, "deploy", made.deploy)
        return made

    return ending


SLOW, NUMB = RobotFault("slow host", "a control step came 70 ms late"), RobotFault("frozen IMU", "the same for 0.30 s")


def test_only_the_fault_that_was_injected_counts_as_the_reaction_to_it(tmp_path: Path, walks: Callable[..., Walks]):
    told, path = walks(SLOW, NUMB, NUMB), trot_policy(PUPPER_V2, tmp_path)
    figures = hardware_reactions.reactions(tmp_path, path)["numb"]()
    assert figures["reaction_ms/numb"] == pytest.approx(70.0, abs=1e-6) and figures["reaction_others/numb"] == 1.0
    assert told.left == [NUMB], "the second walk is the measurement"


def test_a_slow_host_comes_too_late_for_the_host_and_not_for_its_watchdog():
    limits = PUPPER_V2.require_wire().safety
    assert limits.tick_delay < hardware_reactions.LATE < limits.watchdog - PUPPER_V2.control_dt


def test_a_fault_that_others_always_precede_is_not_measured(tmp_path: Path, walks: Callable[..., Walks]):
    walks(*[SLOW] * MOST_FAULTS)
    policy = Policy.load(trot_policy(PUPPER_V2, tmp_path))
    with pytest.raises(NotMeasuredError, match="numb was never reported, but slow host, slow host"):
        reaction(tmp_path, policy, "numb")


def test_only_the_fault_of_the_host_that_was_caused_counts(
    tmp_path: Path, walks: Callable[..., Walks], monkeypatch: pytest.MonkeyPatch
):
    meant = RobotFault("watchdog", "the watchdog process is dead or asleep")
    told = walks(SLOW, ZeroDivisionError("a bug"), meant, SLOW)
    fault = HOST_FAULTS["watchdog_dead"]
    quiet = type(fault)(lambda _: None, fault.error, fault.kind)
    policy = Policy.load(trot_policy(PUPPER_V2, tmp_path))
    assert 0.0 < host_reaction(tmp_path, policy, quiet) < 9000.0 and told.left == [SLOW]


def test_every_fault_that_can_be_injected_has_kinds_that_the_host_knows():
    package = Path(sys.modules["motorprior.hardware.health"].__file__ or "").parent
    written = "".join(path.read_text("utf-8") for path in package.glob("*.py"))
    assert {fault.partition(":")[0] for fault in FAULTS} == set(KINDS)
    kinds = set().union(*FAULTS.values()) | {fault.kind for fault in HOST_FAULTS.values() if fault.kind}
    assert [kind for kind in sorted(kinds) if f'"{kind}"' not in written] == []


def test_a_fault_of_another_joint_is_not_the_one_that_was_meant():
    stuck = [RobotFault("stuck", f"{joint} moved less than 0.02 rad") for joint in ("FR_knee", "RL_hip")]
    assert [is_meant(fault, "frozen:FR_knee") for fault in stuck] == [True, False]
    assert is_meant(RobotFault("fall", "roll +0.81 rad"), "dead:FR_knee") and not is_meant(SLOW, "dead:FR_knee")


def test_silence_that_was_this_machine_s_is_not_the_robot_s(
    tmp_path: Path, walks: Callable[..., Walks], monkeypatch: pytest.MonkeyPatch
):
    told = walks(*[RobotFault("stale telemetry", "the last measurement is 0.2 s old")] * 3)
    always, never = (MachineReport(1000, 0.0, 0.0, 1.0, (np.array(late).reshape(-1, 2),)) for late in ([0.0, 1e12], []))
    reports = iter((always, never))

    def timers() -> SimpleNamespace:
        report = next(reports)
        return SimpleNamespace(stop=lambda: report)

    monkeypatch.setattr(hardware_reactions, "BareTimers", timers)
    others: list[str] = []
    reaction(tmp_path, Policy.load(trot_policy(PUPPER_V2, tmp_path)), "mute", others)
    assert others == ["stale telemetry"] and len(told.left) == 1, "the second walk is the measurement"


@pytest.mark.parametrize(
    ("facts", "found"),
    [({"outcome": "SIGINT"}, "SIGINT"), ({"outcome": "slow host"}, "slow host"), ({}, None), (None, "no facts")],
)
def test_a_run_says_what_ended_it(tmp_path: Path, facts: dict | None, found: str | None):
    if facts is not None:
        (tmp_path / "run.json").write_text(json.dumps(facts))
    assert outcome(tmp_path) == found
