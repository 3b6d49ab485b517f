"""The benchmark of deployment keeps what it measured when a part of it fails."""

from pathlib import Path

import pytest

from hardware import measure, parts, trot_policy
from hardware_reactions import FAULTS, HOST_FAULTS, WORDS, NotMeasuredError
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
