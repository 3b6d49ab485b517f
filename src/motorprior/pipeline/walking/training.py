"""A resumable training: interrupted at any time, it continues to the same bytes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, MotorPriorError
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.walking.walk_metrics import EVENTS, Metrics, tensorboard_events
from motorprior.search.ars import Ars, ArsConfig
from motorprior.search.executor import Executor, Kind, make_executor, many_executors
from motorprior.search.policy_search import BestPolicy, Iteration, updated_best, is_settled, new_search, train
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.engines import Scene
from motorprior.simulation.fatal_errors import saved_on_fatal_error
from motorprior.simulation.world_step import FAULTS

CHECKPOINT = "search.safetensors"
Curve = list[dict[str, Any]]


@contextmanager
def executors(
    scenes: list[Scene], workers: int, kind: Kind = "threads", address: str | None = None
) -> Iterator[tuple[Executor, Executor]]:
    """Executors of the training episodes and of the evaluation episodes.

    Args:
        scenes: of the training, and of the evaluation if it has other motors.
        workers: episodes at a time.
        kind: see `make_executor`.
        address: see `make_executor`.
    """
    with ExitStack() as stack:
        if len(scenes) > 1:
            stack.enter_context(many_executors(kind, workers, address))
        made = [
            stack.enter_context(closing(make_executor(scene.simulator, workers, kind, address))) for scene in scenes
        ]
        yield made[0], made[-1]


@dataclass(frozen=True)
class Training:
    """A training with a checkpoint.

    Attributes:
        search: settings of the search.
        shape: of the policy.
        start: a policy to continue from.
        iterations: at most.
        patience: see `policy_search.train`.
        episode_steps: control steps of an episode at most.
        folder: for checkpoint and metrics.
        wanted: `stage.description`, which a checkpoint must match.
        save: writes the policy of a champion.
        tensorboard: also write events for TensorBoard.
    """

    search: ArsConfig
    shape: PolicyShape
    start: Policy | None
    iterations: int
    patience: int | None
    episode_steps: int
    folder: Path
    wanted: dict[str, Any]
    save: Callable[[BestPolicy], None]
    tensorboard: bool = False

    def run(self, executor: Executor, evaluator: Executor, progress: Progress, name: str) -> tuple[BestPolicy, Curve]:
        """Train from the checkpoint, if there is one; save one when interrupted or when episodes fail.

        Args:
            executor: runs the training episodes.
            evaluator: runs the evaluation episodes.
            progress: where to report to.
            name: of the training.
        """
        search, champion, curve = self._load() or (
            new_search(self.search, self.shape, self.start), BestPolicy.none_yet(self.shape), [],
        )  # fmt: skip
        if search.iteration == 0:  # the initial policy is kept if nothing improves on it
            champion = updated_best(search, self.shape, evaluator, champion)
        else:
            progress.note(f"{name}: continues after iteration {search.iteration}")
        latest = {**search.state(), **champion.state()}
        saved, took = time.monotonic(), 0.0

        def report(point: Iteration, best: BestPolicy) -> None:
            nonlocal latest, saved, took
            curve.append(as_point(point))
            latest = {**search.state(), **best.state()}
            task.advance(1, metrics.add(curve[-1]))
            now = time.monotonic()
            if took <= 0.5 * (now - saved):  # saving takes at most a third of the time
                self._save_checkpoint(latest, curve)
                saved = time.monotonic()
                took = saved - now

        try:
            with (
                saved_on_fatal_error(lambda: self._rescue(latest, curve)),
                tensorboard_events(self.folder / EVENTS) if self.tensorboard else nullcontext(lambda row: None) as also,
                progress.start(f"{name}: {self.iterations} iterations", self.iterations) as task,
            ):
                metrics = Metrics(self.folder, curve, 2 * self.search.num_directions, self.episode_steps, also)
                task.advance(search.iteration)
                champion = train(
                    search, self.shape, executor, self.iterations, champion, report, evaluator, self.patience
                )
        except (KeyboardInterrupt, MotorPriorError):
            self._save_checkpoint(latest, curve)
            raise
        if search.iteration < self.iterations and is_settled(search, champion, self.patience):
            progress.note(
                f"{name}: ended after {search.iteration} iterations, no better policy since {champion.iteration}"
            )
        return champion, curve

    def _save_checkpoint(self, state: dict[str, np.ndarray], curve: Curve) -> None:
        points = curve[: int(state["iteration"])]  # interrupted between the two, the curve is a point ahead
        write_tensors(self.folder / CHECKPOINT, state, {"wanted": self.wanted, "curve": points})

    def _load(self) -> tuple[Ars, BestPolicy, Curve] | None:
        """The training of an interrupted run with the same settings."""
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return None
        try:
            state, header = read_tensors(path)
            if header.get("wanted") != self.wanted:
                return None
            best = {name: state.pop(name) for name in list(state) if name.startswith("champion_")}
            return Ars.restore(self.search, state), BestPolicy.restore(best), header["curve"]
        except (ArtifactError, KeyError) as error:
            problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
            raise ArtifactError(problem, where=path, remedy="delete it to train from the start") from error

    def _rescue(self, latest: dict[str, np.ndarray], curve: Curve) -> str:
        """Save everything, and the best policy so far, when MuJoCo ends the process."""
        self._save_checkpoint(latest, curve)
        what = f"{int(latest['iteration'])} iterations"
        best = BestPolicy.restore({name: value for name, value in latest.items() if name.startswith("champion_")})
        if best.iteration >= 0:
            self.save(best)
            what += f" and the best policy so far, of iteration {best.iteration},"
        return f"{what} are kept in {self.folder}"


def as_point(point: Iteration) -> dict[str, Any]:
    """A point of the learning curve, with its faults by name."""
    return asdict(point) | {"faults": {FAULTS[fault]: n for fault, n in point.faults.items()}}
