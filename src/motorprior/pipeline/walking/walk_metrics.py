"""metrics.jsonl: how a training goes, a line per iteration, written as it happens; and the same in a few words."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import parse_json, write_text
from motorprior.exceptions import ArtifactError
from motorprior.files import read_text

METRICS = "metrics.jsonl"
MAX_BYTES = 40_000_000
"""Of a file; a line at a time is parsed, and seven numbers of it are kept."""
_NUMBERS = ("iteration", "episodes", "return_mean", "return_best", "steps_mean", "upright", "speed_error")


@dataclass(frozen=True)
class Extent:
    """How long a training is.

    Attributes:
        iterations: at most.
        episode_steps: control steps of an episode at most.
        episodes: of one iteration without contests.
        may_end_early: whether it has a patience.
    """

    iterations: int
    episode_steps: int
    episodes: int
    may_end_early: bool = False


class Metrics:
    """Lines about a training that is under way.

    What is in the file follows from the learning curve alone, so that it is the same however often a training was
    interrupted: a new process writes it anew from the curve of its checkpoint, which cuts what is ahead of that, and a
    line that a killed process half wrote.

    Args:
        folder: of the walk.
        curve: points so far, see `training.as_point`.
        extent: of the training.
        also: called with every row, from the first one on.
    """

    def __init__(
        self,
        folder: Path,
        curve: Sequence[dict[str, Any]],
        extent: Extent,
        also: Callable[[Mapping[str, Any]], None] | None = None,
    ):
        self._path, self._extent, self._also = folder / METRICS, extent, also or (lambda row: None)
        self._began, self._before = time.monotonic(), len(curve)
        rows = [self._row(point) for point in curve]
        write_text(self._path, "".join(map(_line, rows)))
        for row in rows:
            self._also(row)

    def add(self, point: dict[str, Any]) -> str:
        """Append a line; returns it in words. Time left and return come first, since a narrow terminal cuts the end."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(_line(row := self._row(point)))
        self._also(row)
        iterations = int(point["iteration"]) + 1
        done, seconds = iterations - self._before, max(1e-9, time.monotonic() - self._began)
        left = seconds / done * (self._extent.iterations - iterations)
        rate = self._extent.episodes * done / seconds
        upright, at_most = 100.0 * self._upright(point), "at most " if self._extent.may_end_early else ""
        return (
            f"{at_most}{_time(left)} left, return {point['mean_return']:.2f} m, upright {upright:.0f} %, "
            f"speed error {point['mean_speed_error']:.2f} m/s, {rate:.0f} episodes/s"
        )

    def _upright(self, point: dict[str, Any]) -> float:
        return point["mean_steps"] / self._extent.episode_steps

    def _row(self, point: dict[str, Any]) -> dict[str, Any]:
        """Return of the perturbed policies [m], share of the time upright [-], speed error [m/s], episodes so far."""
        return {
            "iteration": point["iteration"],
            "episodes": self._extent.episodes * (int(point["iteration"]) + 1),
            "return_mean": point["mean_return"],
            "return_best": point["best_return"],
            "steps_mean": point["mean_steps"],
            "upright": self._upright(point),
            "speed_error": point["mean_speed_error"],
            "faults": dict(sorted(point["faults"].items())),
        }


def _line(row: dict[str, Any]) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def read_metrics(folder: Path) -> dict[str, np.ndarray]:
    """(N,) values of every quantity of a finished training, by name.

    Raises:
        ArtifactError: no such file, or a line that `Metrics` did not write.
    """
    path = folder / METRICS
    try:
        rows = [_numbers(parse_json(line)) for line in read_text(path, MAX_BYTES).splitlines()]
        return {name: np.array([row[column] for row in rows]) for column, name in enumerate(_NUMBERS)}
    except (ValueError, KeyError, TypeError) as error:
        raise ArtifactError(f"not the metrics of a training ({error})", where=path, remedy="train again") from error


def _numbers(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in _NUMBERS)


def _time(seconds: float) -> str:
    """Minutes and seconds, hours from the first one on."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
