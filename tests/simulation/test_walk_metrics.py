"""metrics.jsonl: a line per iteration, the same bytes however often a training was interrupted."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from motorprior.commands.walk import CURVE, Walk, run_walk
from motorprior.simulation.training import EVENTS, METRICS


class Stops:
    """Progress that keeps the notes of a training, and interrupts it after some iterations."""

    def __init__(self, after: int):
        self.notes: list[str] = []
        self._after = after

    @contextmanager
    def start(self, name: str, total: int) -> Iterator["Stops"]:
        yield self

    def advance(self, count: int = 1, note: str = "") -> None:
        self.notes += [note] if note else []
        if len(self.notes) == self._after:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        pass


def small(folder: Path) -> Walk:
    return Walk(out=folder, motors="pd", iterations=4, episode_steps=20, workers=1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    folder, seen = tmp_path_factory.mktemp("whole"), Stops(99)
    run_walk(small(folder), seen)
    return folder, seen.notes


def test_a_line_contains_the_point_of_the_learning_curve(whole: tuple[Path, list[str]]):
    lines = [json.loads(line) for line in (whole[0] / METRICS).read_text("utf-8").splitlines()]
    curve = json.loads((whole[0] / CURVE).read_text("utf-8"))
    assert [line["iteration"] for line in lines] == [0, 1, 2, 3]
    episodes = 2 * Walk(out=Path(), motors="pd").search.num_directions
    assert [line["episodes"] for line in lines] == [episodes * n for n in (1, 2, 3, 4)]
    for line, point in zip(lines, curve, strict=True):
        assert (line["return_mean"], line["return_best"]) == (point["mean_return"], point["best_return"])
        assert line["upright"] == point["mean_steps"] / 20 and line["speed_error"] == point["mean_speed_error"]
    assert not {"seconds", "time"} & lines[0].keys()


def test_tensorboard_gets_every_line_once_after_an_interrupt_too(tmp_path: Path):
    pytest.importorskip("tensorboardX", reason="pip install 'motorprior[tensorboard]'")
    walk = replace(small(tmp_path), tensorboard=True)
    with pytest.raises(KeyboardInterrupt):
        run_walk(walk, Stops(after=2))
    run_walk(walk)
    (events,) = (tmp_path / EVENTS).iterdir()
    assert events.read_bytes().count(b"walk/upright") == 4
