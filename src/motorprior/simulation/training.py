"""A resumable training: interrupted at any time, it continues to the same bytes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, MotorPriorError, SimulationFault
from motorprior.identification.prior_file import prior_notes
from motorprior.locomotion.ars import Ars, ArsConfig
from motorprior.locomotion.executor import Executor, Kind, make_executor
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_search import BestPolicy, Iteration, has_converged, new_search, train, updated_best
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.progress import Progress
from motorprior.robots.robot import Robot
from motorprior.simulation.engines import Scene
from motorprior.simulation.fatal_errors import saved_on_fatal_error
from motorprior.simulation.walk_metrics import EVENTS, Metrics, tensorboard_events
from motorprior.simulation.world_step import FAULTS

CHECKPOINT = "search.safetensors"
Curve = list[dict[str, Any]]


@contextmanager
def executors(
    scenes: list[Scene], workers: int, kind: Kind = "threads", address: str | None = None
) -> Iterator[tuple[Executor, Executor]]:
    """Executors of the training episodes and of the evaluation episodes, see `make_executor`.

    Args:
        scenes: of the training, and of the evaluation if it has other motors.
        workers: episodes at a time.
        kind: of executor.
        address: of a Ray cluster.
    """
    with ExitStack() as stack:
        made = [
            stack.enter_context(closing(make_executor(scene.simulator, workers, kind, address))) for scene in scenes
        ]
        yield made[0], made[-1]


@dataclass(frozen=True)
class Training:
    """A training with a checkpoint."""

    search: ArsConfig
    shape: PolicyShape
    start: Policy | None  # to continue from
    iterations: int
    patience: int | None  # see `policy_search.train`
    episode_steps: int
    folder: Path  # for checkpoint and metrics
    wanted: dict[str, Any]  # `stage.description`, which a checkpoint must match
    save: Callable[[BestPolicy], None]  # writes the policy file
    tensorboard: bool = False  # also write events for TensorBoard

    def run(self, executor: Executor, evaluator: Executor, progress: Progress, name: str) -> tuple[BestPolicy, Curve]:
        """Train from the checkpoint, if there is one; save one when interrupted or when episodes fail.

        Args:
            executor: runs the training episodes.
            evaluator: runs the evaluation episodes.
            progress: where to report to.
            name: of the training.
        """
        search, best, curve = self._load() or (
            new_search(self.search, self.shape, self.start), BestPolicy.none_yet(self.shape), [],
        )  # fmt: skip
        if search.iteration == 0:  # the initial policy is kept if nothing improves on it
            best = updated_best(search, self.shape, evaluator, best)
        else:
            progress.note(f"{name}: continues after iteration {search.iteration}")
        latest = {**search.state(), **best.state()}
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
                saved_on_fatal_error(lambda: self._save_all(latest, curve)),
                tensorboard_events(self.folder / EVENTS) if self.tensorboard else nullcontext(lambda row: None) as also,
                progress.start(f"{name}: {self.iterations} iterations", self.iterations) as task,
            ):
                metrics = Metrics(self.folder, curve, 2 * self.search.num_directions, self.episode_steps, also)
                task.advance(search.iteration)
                best = train(search, self.shape, executor, self.iterations, best, report, evaluator, self.patience)
        except (KeyboardInterrupt, MotorPriorError):
            self._save_checkpoint(latest, curve)
            raise
        if search.iteration < self.iterations and has_converged(search, best, self.patience):
            progress.note(f"{name}: ended after {search.iteration} iterations, no better policy since {best.iteration}")
        return best, curve

    def _save_checkpoint(self, state: dict[str, np.ndarray], curve: Curve) -> None:
        points = curve[: int(state["iteration"])]  # after an interruption between the two, the curve is one point ahead
        write_tensors(self.folder / CHECKPOINT, state, {"wanted": self.wanted, "curve": points})

    def _load(self) -> tuple[Ars, BestPolicy, Curve] | None:
        """State of an interrupted training with the same settings."""
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return None
        try:
            state, header = read_tensors(path)
            if header.get("wanted") != self.wanted:
                return None
            return Ars.restore(self.search, state), BestPolicy.restore(state), header["curve"]
        except (ArtifactError, KeyError) as error:
            problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
            raise ArtifactError(problem, where=path, remedy="delete it to train from the start") from error

    def _save_all(self, latest: dict[str, np.ndarray], curve: Curve) -> str:
        """Save checkpoint and best policy when MuJoCo ends the process; returns a message."""
        self._save_checkpoint(latest, curve)
        message = f"{int(latest['iteration'])} iterations"
        best = BestPolicy.restore(latest)
        if best.iteration >= 0:
            self.save(best)
            message += f" and the best policy so far, of iteration {best.iteration},"
        return f"{message} are saved in {self.folder}"


def as_point(point: Iteration) -> dict[str, Any]:
    """A point of the learning curve, with its faults by name."""
    return asdict(point) | {"faults": {FAULTS[fault]: n for fault, n in point.faults.items()}}


def report_faults(curve: Curve, episodes: int, progress: Progress) -> None:
    """Report the simulation faults of a training with ``episodes`` per iteration.

    Raises:
        SimulationFault: every episode had one.
    """
    faults, total = sum((Counter(point.get("faults", {})) for point in curve), Counter()), len(curve) * episodes
    for name, count in faults.items():
        progress.note(f"{count} of {total} episodes ended early: {name}")
    if faults.total() == total:
        raise SimulationFault(
            f"each of the {total} episodes had a simulation fault ({', '.join(faults)})",
            remedy="the motors are too stiff or too strong for the physics step: use smaller gains or softer motors",
        )


def policy_of(robot: Robot, gait: GaitName, best: BestPolicy, nominal: IdealPd, provenance: dict[str, Any]) -> Policy:
    """The best policy of a training.

    Args:
        robot: with the speed range of the training.
        gait: of the training.
        best: result of the search.
        nominal: PD gains of the robot's motors.
        provenance: settings of the training.
    """
    arrays = best.policy
    return Policy(
        np.ascontiguousarray(arrays.weights), arrays.hidden, arrays.readout, arrays.mean, arrays.std, nominal.kp,
        nominal.kd, robot.control_dt, robot.name, robot.joint_names, robot.require_legs().forward, gait,
        provenance | {"iteration": best.iteration, "own_return": best.score},
    )  # fmt: skip


def training_notes(robot: Robot, prior: MotorPrior | None, validation: Fleet | str | Path | None) -> list[str]:
    """Notes on limits of the prior, and on a validation fleet that biases later evaluation on the twin."""
    notes = [] if prior is None else prior_notes(prior, robot)
    if validation is not None and robot.fleets and load_robot_fleet(robot, validation).name == robot.default_fleet:
        notes.append(
            "note: validation uses the fleet of the twin, so results on this twin are biased: evaluate the policy on "
            "another fleet, or validate on another"
        )
    return notes


def require_sizes(iterations: int, episode_steps: int, workers: int, hidden_units: int, patience: int | None) -> None:
    """Raise ConfigError for a size of a training that is out of range."""
    for name, value in (("iterations", iterations), ("episode_steps", episode_steps), ("workers", workers)):
        require_count(name, value)
    require_count("hidden_units", hidden_units, 0)
    if patience is not None:
        require_count("patience", patience)
