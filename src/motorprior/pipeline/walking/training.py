"""A training that can be interrupted at any time and goes on to the same bytes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, MotorPriorError
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.walking.tensorboard import EVENTS, events
from motorprior.pipeline.walking.walk_metrics import Extent, Metrics
from motorprior.search.ars import Ars, ArsConfig
from motorprior.search.executor import Executor
from motorprior.search.policy_search import Champion, Iteration, contest, is_settled, new_search, train
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.fatal_errors import saved_on_fatal_error
from motorprior.simulation.world_step import FAULTS

CHECKPOINT = "search.safetensors"
_SAVING_SHARE = 0.5
"""Every iteration is saved, unless saving took more than this share of the time since the last time."""


@dataclass(frozen=True)
class Checkpoint:
    """Where the state of a training goes: its folder and the description of its stage."""

    folder: Path
    wanted: dict

    def save(self, state: dict[str, np.ndarray], curve: list[dict]) -> None:
        """Write the state; the curve may be a point ahead when interrupted between the two, and is cut to it."""
        points = curve[: int(state["iteration"])]
        write_tensors(self.folder / CHECKPOINT, state, {"wanted": self.wanted, "curve": points})

    def load(self, config: ArsConfig) -> tuple[Ars, Champion, list[dict]] | None:
        """The training of an interrupted run with the same settings, if there is one.

        Raises:
            ArtifactError: the checkpoint is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return None
        try:
            state, header = read_tensors(path)
            if header.get("wanted") != self.wanted:
                return None
            best = {name: state.pop(name) for name in list(state) if name.startswith("champion_")}
            return Ars.restore(config, state), Champion.restore(best), header["curve"]
        except (ArtifactError, KeyError) as error:
            problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
            raise ArtifactError(problem, where=path, remedy="delete it to train from the start") from error


@dataclass(frozen=True)
class Training:
    """What a training needs.

    Attributes:
        config: of the search.
        shape: of the policy.
        start: a policy to go on from.
        executor: where candidates walk.
        judge: where contests are walked.
        extent: of the training.
        patience: see `policy_search.train`.
        checkpoint: where its state goes.
        save: writes the policy of a champion.
        tensorboard: whether the curve is written as events, too.
    """

    config: ArsConfig
    shape: PolicyShape
    start: Policy | None
    executor: Executor
    judge: Executor
    extent: Extent
    patience: int | None
    checkpoint: Checkpoint
    save: Callable[[Champion], None]
    tensorboard: bool = False

    def run(self, progress: Progress, name: str) -> tuple[Champion, list[dict[str, Any]]]:
        """Train from the checkpoint, if there is one; leave a checkpoint when interrupted or when episodes fail."""
        with ExitStack() as stack:
            also = stack.enter_context(events(self.checkpoint.folder / EVENTS)) if self.tensorboard else None
            return self._run(progress, name, also)

    def _run(
        self, progress: Progress, name: str, also: Callable[[Mapping[str, Any]], None] | None
    ) -> tuple[Champion, list[dict[str, Any]]]:
        search, champion, curve = self.checkpoint.load(self.config) or self._new()
        if search.iteration == 0:  # what nothing improves on is kept
            champion = contest(search, self.shape, self.judge, champion)
        else:
            progress.note(f"{name}: goes on after iteration {search.iteration}")
        latest, iterations = _state(search, champion), self.extent.iterations
        metrics = Metrics(self.checkpoint.folder, curve, self.extent, also)
        saved, took = time.monotonic(), 0.0
        try:
            with (
                progress.start(f"{name}: {iterations} iterations", iterations) as task,
                saved_on_fatal_error(lambda: self._rescue(latest, curve)),
            ):
                task.advance(search.iteration)

                def report(point: Iteration, best: Champion) -> None:
                    nonlocal latest, saved, took
                    curve.append(as_point(point))
                    latest = _state(search, best)
                    task.advance(1, metrics.add(curve[-1]))
                    now = time.monotonic()
                    if took <= _SAVING_SHARE * (now - saved):
                        self.checkpoint.save(latest, curve)
                        saved = time.monotonic()
                        took = saved - now

                champion = train(
                    search, self.shape, self.executor, iterations, champion, report, self.judge, self.patience
                )
        except (KeyboardInterrupt, MotorPriorError):  # the second: a fault of the simulation, or lost workers
            self.checkpoint.save(latest, curve)
            raise
        if search.iteration < iterations and is_settled(search, champion, self.patience):
            progress.note(
                f"{name}: ended after {search.iteration} iterations, no better policy since {champion.iteration}"
            )
        return champion, curve

    def _new(self) -> tuple[Ars, Champion, list[dict]]:
        return new_search(self.config, self.shape, self.start), Champion.none_yet(self.shape), []

    def _rescue(self, latest: dict[str, np.ndarray], curve: list[dict]) -> str:
        """Keep everything, and the best policy so far, when MuJoCo ends the process."""
        self.checkpoint.save(latest, curve)
        what = f"{int(latest['iteration'])} iterations"
        best = Champion.restore({name: value for name, value in latest.items() if name.startswith("champion_")})
        if best.iteration >= 0:
            self.save(best)
            what += f" and the best policy so far, of iteration {best.iteration},"
        return f"{what} are kept in {self.checkpoint.folder}"


def as_point(point: Iteration) -> dict[str, Any]:
    """A point of the curve, with its faults by name."""
    return asdict(point) | {"faults": {FAULTS[fault]: n for fault, n in point.faults.items()}}


def _state(search: Ars, champion: Champion) -> dict[str, np.ndarray]:
    """Everything a later run needs to end at the same bytes."""
    return {**search.state(), **champion.state()}
