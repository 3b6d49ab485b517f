"""Seconds add up over interruptions, a finished stage keeps its own, and only what was asked for belongs to a run."""

from collections.abc import Callable
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.cli import run_record
from motorprior.cli.run_record import RunRecord, belongs, stage_folder
from motorprior.cli.stage import begin, finish

SETTINGS = {"seed": 0}


class Clock:
    """A time that only work moves."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(run_record, "time", clock)
    return clock


@pytest.fixture
def stage(tmp_path: Path, clock: Clock) -> Callable[..., Callable[[], None]]:
    """Work of some seconds that ends with a marker, or is interrupted before."""

    def make(name: str, seconds: float, result: int = 0, interrupted: bool = False) -> Callable[[], None]:
        folder = tmp_path / stage_folder(name)

        def work() -> None:
            begin(folder)
            clock.now += seconds
            if interrupted:
                raise KeyboardInterrupt
            finish(folder, {"result": result})

        return work

    return make


def found() -> None:
    """Work that finds its stage finished."""


def seconds(run: Path) -> dict[str, float]:
    return {name: entry["seconds"] for name, entry in read_json(run / "seconds.json").items()}


def test_an_interrupted_stage_counts_all_its_parts(tmp_path: Path, stage: Callable):
    for part in (40.0, 7.0):
        with pytest.raises(KeyboardInterrupt):
            RunRecord(tmp_path, SETTINGS).run("walk a", stage("walk a", part, interrupted=True))
    record = RunRecord(tmp_path, SETTINGS)
    record.run("walk a", stage("walk a", 3.0))
    assert record.total() == pytest.approx(50.0)


def test_unfinished_work_on_other_settings_does_not_count(tmp_path: Path, stage: Callable):
    with pytest.raises(KeyboardInterrupt):
        RunRecord(tmp_path, {"seed": 1}).run("validate", stage("validate", 40.0, interrupted=True))
    record = RunRecord(tmp_path, SETTINGS)
    record.run("validate", stage("validate", 3.0))
    assert record.total() == pytest.approx(3.0)


def test_a_stage_found_finished_keeps_its_seconds_and_one_run_anew_gets_new_ones(tmp_path: Path, stage: Callable):
    RunRecord(tmp_path, SETTINGS).run("validate", stage("validate", 40.0))
    again = RunRecord(tmp_path, {"seed": 1})
    again.run("validate", found)
    assert again.total() == pytest.approx(40.0)
    anew = RunRecord(tmp_path, SETTINGS)
    anew.run("validate", stage("validate", 2.0, result=1))
    assert anew.total() == pytest.approx(2.0), "not the longer of the two"


def test_only_the_stages_of_this_run_count(tmp_path: Path, stage: Callable):
    wide = RunRecord(tmp_path, {"seeds": 2})
    for name in ("walk rollout_0", "walk rollout_1"):
        wide.run(name, stage(name, 10.0))
    narrow = RunRecord(tmp_path, {"seeds": 1})
    narrow.run("walk rollout_0", found)
    assert narrow.total() == pytest.approx(10.0)
    assert belongs(tmp_path, "walk/rollout_0") and not belongs(tmp_path, "walk/rollout_1")


def test_imports_and_pages_count_too(tmp_path: Path, stage: Callable, clock: Clock):
    started, clock.now = clock.now, clock.now + 2.0  # imports
    first = RunRecord(tmp_path, SETTINGS, started)
    first.run("validate", stage("validate", 10.0))
    clock.now += 3.0  # a page
    with pytest.raises(KeyboardInterrupt):
        first.run("transfer", stage("transfer", 1.0, interrupted=True))
    started, clock.now = clock.now, clock.now + 2.0
    second = RunRecord(tmp_path, SETTINGS, started)
    second.run("validate", found)
    second.run("transfer", stage("transfer", 4.0))
    clock.now += 3.0
    assert second.total() == pytest.approx(10 + 1 + 4 + 2 * (2 + 3))
    third = RunRecord(tmp_path, SETTINGS)
    clock.now += 1.0
    for name in ("validate", "transfer"):
        third.run(name, found)
    assert third.total() == pytest.approx(25.0), "a run that finds everything done adds nothing"


def test_what_is_measured_every_time_counts_once(tmp_path: Path, clock: Clock):
    def measure() -> None:
        clock.now += 5.0

    for _ in range(2):
        record = RunRecord(tmp_path, SETTINGS)
        record.run("speed", measure)
        assert record.total() == pytest.approx(5.0)


def test_a_stage_belongs_until_its_marker_changes_or_another_run_begins(tmp_path: Path, stage: Callable):
    assert not belongs(tmp_path, "priors/paper")
    RunRecord(tmp_path, SETTINGS).run("identify paper", stage("identify paper", 1.0))
    assert belongs(tmp_path, "priors/paper")
    stage("identify paper", 1.0, result=1)()
    assert not belongs(tmp_path, "priors/paper")
    RunRecord(tmp_path, SETTINGS).run("identify paper", found)
    assert belongs(tmp_path, "priors/paper")
    RunRecord(tmp_path, {"seed": 1})
    assert not belongs(tmp_path, "priors/paper")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"validate": 1}', '{"validate": {"seconds": NaN}}'])
def test_damaged_files_are_begun_anew(tmp_path: Path, stage: Callable, text: str):
    for name in ("seconds.json", "stages.json"):
        (tmp_path / name).write_text(text)
    assert not belongs(tmp_path, "validate")
    record = RunRecord(tmp_path, SETTINGS)
    record.run("validate", stage("validate", 2.0))
    assert record.total() == pytest.approx(2.0) and seconds(tmp_path)["validate"] == 2.0
