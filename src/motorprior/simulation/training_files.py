"""Files of a training while it runs: checkpoint, metrics.jsonl with one line per iteration, TensorBoard events.

Interrupted at any time, a training continues from its checkpoint to the same bytes.
"""

# pyright: reportMissingImports=false
# tensorboardX is an extra.
from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors, write_text
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.policy_search import PolicySearch

CHECKPOINT, METRICS, EVENTS = "search.safetensors", "metrics.jsonl", "tensorboard"
Curve = list[dict[str, Any]]  # points of the learning curve: `policy_search.Iteration`, with its faults by name


class TrainingFiles:
    """Writes the files; a checkpoint in the folder is continued if its `stage.description` is ``wanted``."""

    def __init__(self, folder: Path, wanted: Mapping[str, Any], tensorboard: bool = False):
        self._folder, self._wanted, self._tensorboard, self._events = folder, wanted, tensorboard, None
        if tensorboard and find_spec("tensorboardX") is None:
            remedy = "pip install 'motorprior[tensorboard]'"
            raise ConfigError("tensorboardX is not installed", remedy=remedy, argument="tensorboard")

    def begin(self, search: PolicySearch, episode_steps: int) -> Curve:
        """Restore a search from the checkpoint, if there is one; begins the other files. Returns the curve so far.

        Raises:
            ArtifactError: a damaged checkpoint.
        """
        curve, path = [], self._folder / CHECKPOINT
        if path.is_file():
            try:
                state, header = read_tensors(path)
                if header.get("wanted") == self._wanted:
                    search.restore(state)
                    curve = header["curve"]
            except (ArtifactError, KeyError) as error:
                problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
                raise ArtifactError(problem, where=path, remedy="delete it to train from the start") from error
        self._episodes, self._episode_steps = 2 * search.ars.config.num_directions, episode_steps
        write_text(self._folder / METRICS, "")
        if self._tensorboard:
            import tensorboardX  # here, since it is an extra

            shutil.rmtree(self._folder / EVENTS, ignore_errors=True)
            self._events = tensorboardX.SummaryWriter(str(self._folder / EVENTS))
        for point in curve:
            self._add(point)
        return curve

    def save(self, state: dict[str, np.ndarray], curve: Curve) -> None:
        """Write the checkpoint after the last point of the curve, and add this point to the metrics."""
        write_tensors(self._folder / CHECKPOINT, state, {"wanted": self._wanted, "curve": curve})
        self._add(curve[-1])

    def close(self) -> None:
        """Close the events."""
        if self._events is not None:
            self._events.close()

    def _add(self, point: Mapping[str, Any]) -> None:
        row = {
            "iteration": point["iteration"],
            "episodes": self._episodes * (int(point["iteration"]) + 1),  # so far
            "return_mean": point["mean_return"],  # of the perturbed policies [m]
            "return_best": point["best_return"],
            "steps_mean": point["mean_steps"],
            "upright": point["mean_steps"] / self._episode_steps,  # share of the time
            "speed_error": point["mean_speed_error"],  # [m/s]
            "faults": dict(sorted(point["faults"].items())),
        }
        with (self._folder / METRICS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")
        if self._events is not None:
            for name in ("return_mean", "return_best", "upright", "speed_error"):
                self._events.add_scalar(f"walk/{name}", row[name], row["iteration"])
            self._events.flush()
