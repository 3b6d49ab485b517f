"""A bar ends where its work ends, and bars of several threads share one drawing."""

import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest
from rich.console import Console

from motorprior.cli import console
from motorprior.cli.console import Bar, Terminal
from motorprior.identification.networks import descent
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import in_parallel
from motorprior.pipeline.walking.walk_metrics import Extent, Metrics


@pytest.mark.parametrize("steps", [1, 4, 10, 11])
def test_the_steps_of_an_identification_add_up(
    motorprior: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, bench: Path, steps: int
):
    done: list[int] = []
    monkeypatch.setattr(descent, "CHUNK", 4)
    monkeypatch.setattr(Bar, "advance", lambda self, count=1, note="": done.append(count))
    assert (
        motorprior("identify", bench, "--preset", "paper_wide", "--steps", steps, "--out", tmp_path / "out").code == 0
    )
    assert sum(done) == steps


@pytest.mark.parametrize("terminal", [True, False])
def test_work_in_several_threads_is_shown_together(monkeypatch: pytest.MonkeyPatch, terminal: bool):
    shown = StringIO()
    monkeypatch.setattr(console, "CONSOLE", Console(file=shown, force_terminal=terminal, width=120))
    progress, meeting, drawings = Terminal(), Barrier(2, timeout=60.0), []

    def work(name: str, given: Progress) -> None:
        with given.start(name, 2) as task:
            meeting.wait()
            drawings.append(progress._drawing)
            meeting.wait()
            task.advance(2, "done")

    in_parallel([lambda given, name=name: work(name, given) for name in ("first", "second")], 2, progress)
    assert drawings[0] is drawings[1] and (drawings[0] is not None) == terminal
    assert progress._drawing is None, "the last one ends the drawing"
    assert all(f"{name}: " in shown.getvalue() for name in ("first", "second"))


@pytest.mark.parametrize("width", [80, 160])
def test_iterations_and_time_left_of_a_training_are_seen_on_any_terminal(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, width: int
):
    shown, progress = StringIO(), Terminal()
    monkeypatch.setattr(console, "CONSOLE", Console(file=shown, force_terminal=True, width=width, color_system=None))
    metrics = Metrics(tmp_path, [], Extent(1000, 100, 32, may_end_early=True))
    means = {"mean_return": 1.5, "best_return": 2.0, "mean_steps": 80.0, "mean_speed_error": 0.05}
    with progress.start("walk, seed 12: 1000 iterations", 1000) as task:
        task.advance(120, metrics.add({"iteration": 119, **means, "faults": {}}))
        assert progress._drawing is not None
        shown.truncate(shown.seek(0))
        progress._drawing.refresh()
        line = next(line for line in shown.getvalue().splitlines() if "seed 12" in line)
    assert "walk, seed 12: 1000 iterations" in line and " 120/1000 " in line
    assert re.search(r"at most \d+:\d\d left, return 1", line), line
    assert ("━" in line, "episodes/s" in line) == (width == 160, width == 160)
