"""Metrics of a training while it runs: metrics.jsonl, one line per iteration, and TensorBoard events."""

# pyright: reportMissingImports=false
# tensorboardX is an extra.
from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import parse_json, write_text
from motorprior.exceptions import ArtifactError
from motorprior.files import read_text

METRICS, EVENTS = "metrics.jsonl", "tensorboard"
_NUMBERS = ("iteration", "episodes", "return_mean", "return_best", "steps_mean", "upright", "speed_error")


class Metrics:
    """Writer of metrics.jsonl; a resumed training writes it again from the curve in its checkpoint.

    Args:
        folder: of the walk.
        curve: points so far, see `training.as_point`.
        episodes: per iteration.
        episode_steps: maximum number of control steps of an episode.
        also: called with every row.
    """

    def __init__(
        self,
        folder: Path,
        curve: Sequence[dict[str, Any]],
        episodes: int,
        episode_steps: int,
        also: Callable[[Mapping[str, Any]], None],
    ):
        self._path, self._episodes, self._episode_steps, self._also = folder / METRICS, episodes, episode_steps, also
        rows = [self._row(point) for point in curve]
        write_text(self._path, "".join(map(_line, rows)))
        for row in rows:
            self._also(row)

    def add(self, point: dict[str, Any]) -> str:
        """Append a line; returns a summary for the user."""
        row = self._row(point)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(_line(row))
        self._also(row)
        return (
            f"return {row['return_mean']:.2f} m, upright {100 * row['upright']:.0f} %, "
            f"speed error {row['speed_error']:.2f} m/s"
        )

    def _row(self, point: dict[str, Any]) -> dict[str, Any]:
        return {
            "iteration": point["iteration"],
            "episodes": self._episodes * (int(point["iteration"]) + 1),  # so far
            "return_mean": point["mean_return"],  # of the perturbed policies [m]
            "return_best": point["best_return"],
            "steps_mean": point["mean_steps"],
            "upright": point["mean_steps"] / self._episode_steps,  # share of the time
            "speed_error": point["mean_speed_error"],  # [m/s]
            "faults": dict(sorted(point["faults"].items())),
        }


def _line(row: dict[str, Any]) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def read_metrics(folder: Path) -> dict[str, np.ndarray]:
    """(N,) values of every quantity of a finished training, by name; ArtifactError if the file cannot be read."""
    path = folder / METRICS
    try:
        rows = [parse_json(line) for line in read_text(path, 40_000_000).splitlines()]
        return {name: np.array([row[name] for row in rows]) for name in _NUMBERS}
    except (ValueError, KeyError, TypeError) as error:
        raise ArtifactError(f"not the metrics of a training ({error})", where=path, remedy="train again") from error


@contextmanager
def tensorboard_events(folder: Path) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """A function that adds a row of metrics.jsonl to new TensorBoard events in ``folder``."""
    import tensorboardX  # here, since it is an extra

    shutil.rmtree(folder, ignore_errors=True)
    writer = tensorboardX.SummaryWriter(str(folder))

    def add(row: Mapping[str, Any]) -> None:
        for name in ("return_mean", "return_best", "upright", "speed_error"):
            writer.add_scalar(f"walk/{name}", row[name], row["iteration"])
        writer.flush()

    try:
        yield add
    finally:
        writer.close()
