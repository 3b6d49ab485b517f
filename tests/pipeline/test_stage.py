"""Seconds add up over interruptions, a finished stage keeps its own, and only what was asked for belongs to a run."""

from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import SimulationFault
from motorprior.pipeline import stopwatch
from motorprior.pipeline.demo import _Stages
from motorprior.pipeline.report import STAGES, belonging_stages, seconds_by_kind
from motorprior.pipeline.stage import MARKER, is_finished, seconds_of, working
from motorprior.pipeline.stopwatch import UNFINISHED

WANTED = {"stage": "walk", "config": {"seed": 0}}


class Clock:
    """A time that only work moves."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(stopwatch, "time", clock)
    return clock


def work(clock: Clock, folder: Path, seconds: float, wanted: dict[str, Any] = WANTED) -> None:
    with working(folder, wanted):
        clock.now += seconds


def interrupted(clock: Clock, folder: Path, seconds: float, wanted: dict[str, Any] = WANTED) -> None:
    with pytest.raises(KeyboardInterrupt), working(folder, wanted):
        clock.now += seconds
        raise KeyboardInterrupt


def test_an_interrupted_stage_counts_all_its_parts(tmp_path: Path, clock: Clock):
    for part in (40.0, 7.0):
        interrupted(clock, tmp_path, part)
        assert not is_finished(tmp_path, WANTED)
    work(clock, tmp_path, 3.0)
    assert is_finished(tmp_path, WANTED) and seconds_of(tmp_path) == pytest.approx(50.0)
    assert [path.name for path in tmp_path.iterdir()] == [MARKER]


def test_a_killed_stage_counts_what_it_noted(tmp_path: Path, clock: Clock):
    with pytest.raises(SystemExit), working(tmp_path, WANTED) as watch:
        clock.now += 40.0
        watch.note()
        clock.now += 100.0
        raise SystemExit
    work(clock, tmp_path, 3.0)
    assert seconds_of(tmp_path) == pytest.approx(43.0)


def test_unfinished_work_on_other_settings_does_not_count(tmp_path: Path, clock: Clock):
    interrupted(clock, tmp_path, 40.0, {"stage": "walk", "config": {"seed": 1}})
    work(clock, tmp_path, 3.0)
    assert seconds_of(tmp_path) == pytest.approx(3.0)


def test_a_stage_run_again_gets_new_seconds(tmp_path: Path, clock: Clock):
    work(clock, tmp_path, 40.0, {"stage": "walk"})
    assert not is_finished(tmp_path, WANTED)
    work(clock, tmp_path, 2.0)
    assert seconds_of(tmp_path) == pytest.approx(2.0) and not is_finished(tmp_path, {"stage": "walk"})


def test_stages_side_by_side_share_the_time(tmp_path: Path, clock: Clock):
    with working(tmp_path / "long", WANTED):
        clock.now += 1.0
        work(clock, tmp_path / "short", 4.0)
        clock.now += 2.0
    assert seconds_of(tmp_path / "short") == pytest.approx(2.0)
    assert seconds_of(tmp_path / "long") == pytest.approx(1.0 + 2.0 + 2.0)


def test_work_before_the_folder_is_taken_can_be_counted(tmp_path: Path, clock: Clock):
    with working(tmp_path, WANTED, since=clock.now - 5.0):
        clock.now += 1.0
    assert seconds_of(tmp_path) == pytest.approx(6.0)


def test_a_refusal_leaves_nothing(tmp_path: Path, clock: Clock):
    with pytest.raises(SimulationFault), working(tmp_path / "walk", WANTED):
        raise SimulationFault("lost")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["", "{", "[]", '{"seconds": 1.0}', '{"stage": "walk", "config": {"seed": 0}}'])
def test_damaged_notes_are_begun_again(tmp_path: Path, clock: Clock, text: str):
    for name in (MARKER, UNFINISHED):
        (tmp_path / name).write_text(text)
    assert not is_finished(tmp_path, WANTED)
    work(clock, tmp_path, 2.0)
    assert seconds_of(tmp_path) == pytest.approx(2.0)


@pytest.mark.parametrize("seconds", [-1.0, 1e13, True, "1", None])
def test_a_marker_with_impossible_seconds_is_no_marker(tmp_path: Path, seconds: object):
    write_json(tmp_path / MARKER, WANTED | {"seconds": seconds})
    assert not is_finished(tmp_path, WANTED)


def test_only_the_stages_that_the_settings_asked_for_belong_to_a_run(tmp_path: Path, clock: Clock):
    wide = _Stages(tmp_path)
    for name in ("walk/rollout_0", "walk/rollout_1", "validate"):
        wide.run(name, lambda name=name: work(clock, tmp_path / name, 10.0))
    assert belonging_stages(tmp_path) == ["validate", "walk/rollout_0", "walk/rollout_1"]
    assert seconds_by_kind(tmp_path) == pytest.approx({"validate": 10.0, "walk": 20.0})
    narrow = _Stages(tmp_path)
    assert belonging_stages(tmp_path) == [], "not before they were asked for"
    narrow.run("walk/rollout_0", lambda: None)
    assert seconds_by_kind(tmp_path) == pytest.approx({"walk": 10.0})
    work(clock, tmp_path / "walk" / "rollout_0", 1.0, {"stage": "another"})
    assert belonging_stages(tmp_path) == [], "its folder holds something else by now"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"nowhere": "x"}'])
def test_without_a_list_nothing_is_known_to_belong(tmp_path: Path, text: str):
    (tmp_path / STAGES).write_text(text)
    assert belonging_stages(tmp_path) == []


def test_the_marker_says_what_was_asked_and_how_long_it_took(tmp_path: Path, clock: Clock):
    work(clock, tmp_path, 2.0)
    assert read_json(tmp_path / MARKER) == {**WANTED, "seconds": 2.0}
