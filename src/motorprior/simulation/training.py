"""Train a walking policy: settings, the loop, its files, and its provenance."""

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.fleet import fleet_files, load_robot_fleet
from motorprior.artifacts import read_tensors, write_json, write_tensors, write_text
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, ConfigError, SimulationFault
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import Executor, ExecutorName, make_executor, require_executor
from motorprior.locomotion.policy import ROBOT_WEIGHT, Policy
from motorprior.locomotion.policy_search import CurvePoint, PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.priors.prior_file import prior_notes
from motorprior.progress import WARNINGS_AND_PROGRESS, Progress, usable_threads
from motorprior.robots.load import as_robot
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.simulation.motors import (
    MotorSource,
    SimulatedMotors,
    motors_as_json,
    simulated_motors,
)
from motorprior.simulation.physics import FAULTS, TOO_STIFF
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.scene import Scene, WalkConfig, simulator_of
from motorprior.simulation.standing import standing_warning
from motorprior.stage import description, digest, is_finished, working
from motorprior.texts import Printable

# files in the folder of a training
POLICY = "policy.safetensors"
SEED_FOLDER = "seed_{}"  # folder of the training with one of several seeds
CURVE = "curve.json"
CHECKPOINT = "search.safetensors"
METRICS = "metrics.jsonl"

MAX_FAULTS = 0.5  # share of episodes with a simulation fault above which a training fails
FIRST_ITERATIONS = 5  # number of iterations after which this share is checked for the first time


@dataclass(frozen=True)
class WalkSettings(WalkConfig):
    """Settings of a training: its episodes, and the search for the policy."""

    episode_steps: int = 1000
    """Control steps per episode. A policy that is trained in short episodes may fall in longer
    walks, because some errors grow slowly."""
    randomization: Randomization = ROBUST
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors,
    pushes."""
    iterations: int = 200
    """ARS iterations."""
    patience: int | None = None
    """The training ends once the mean training return of 20 iterations has not reached a new
    maximum this many times in a row. If not given, it never ends early."""
    validation: str | None = None
    """Fleet, a name or a .toml file. Policies are evaluated on its motors to choose the best one;
    if not given, on the motors of the training. Do not give the fleet of the twin on which the
    policy is tested later."""
    hidden_units: int = 0
    """Number of hidden units of the policy, even for a symmetric policy; 0 for a linear policy."""
    symmetric: bool = True
    """The policy is symmetric: mirrored observations give mirrored actions. It cannot limp to one
    side."""
    search: ArsConfig = field(default_factory=ArsConfig)
    """Augmented random search."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_count("iterations", self.iterations)
        require_count("hidden_units", self.hidden_units, 0)
        if self.patience is not None:
            require_count("patience", self.patience)


def train_policy(
    robot: Robot | str | Path,
    motors: MotorSource,
    settings: WalkSettings | None = None,
    *,
    start: Policy | str | Path | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    executor: ExecutorName = "threads",
    ray_address: str | None = None,
    name: str = "train",
    progress: Progress = WARNINGS_AND_PROGRESS,
    **changes: Any,
) -> Policy:
    """Train a walking policy by augmented random search, on motors sampled for every episode.

    Args:
        robot: a robot with legs: its name, the path of its .toml file, or a robot from
            `load_robot`.
        motors: a text such as "prior:FILE" or "pd:kp=9" (`actuator.registry`); a prior, a posterior
            or a fleet to sample from; fixed motors; or a function of a generator that samples
            motors.
        settings: settings of the training.
        start: the initial policy; the untrained gait if not given. On the same motors, the trained
            policy is never worse than the initial one in evaluation.
        out: folder for policy.safetensors, curve.json and metrics.jsonl. A second call with the
            same arguments loads the policy, or continues an interrupted training. With ``out``,
            motors must be a text, and start a path.
        workers: number of episodes at a time; up to two if not given. The result does not depend on
            it.
        executor: threads of this process, or Ray processes. The result does not depend on it.
        ray_address: address of a running Ray cluster for the executor ray; Ray starts on this
            machine if not given.
        name: name of the training in its progress.
        progress: receives notes and progress.
        changes: fields of `WalkSettings`, such as iterations; ``seed`` is the seed of the
            search.

    Returns:
        The best policy of all evaluations.

    Raises:
        ConfigError: the robot has no legs, the motors do not fit the robot, a number is out of
            range, the start policy has another shape, or the policy of a robot without symmetry
            shall be symmetric.
        ArtifactError: a robot or a validation fleet cannot be read.
        SimulationFault: most episodes had a simulation fault.
    """
    robot = as_robot(robot)
    settings = settings or WalkSettings()
    seed = changes.pop("seed", None)
    settings = replace(settings, **changes)
    if seed is not None:
        settings = replace(settings, search=replace(settings.search, seed=seed))
    if workers is None:
        workers = min(2, os.cpu_count() or 1)

    start_path = Path(start) if isinstance(start, str | Path) else None
    start_policy = Policy.load(start) if isinstance(start, str | Path) else start
    training = Training(robot, motors, settings, start_policy, start_path or "start")

    if out is None:
        training.run(workers, progress, name, executor, ray_address)
        return training.policy(motors=_motors_text(motors))

    out = Path(out)
    if not isinstance(motors, str) or isinstance(start, Policy):
        problem = "out needs motors and start of files"
        raise ConfigError(problem, remedy="give a text and a path", argument="out")
    _require_other_folder(out, start_path)

    inputs = [*training.motors.files, *robot.files]
    if start_path is not None:
        inputs.append(start_path)
    if settings.validation is not None:
        inputs += fleet_files(robot, settings.validation)
    arguments = asdict(settings) | {"motors": motors, "robot": robot.name}
    stage = description("walk", arguments, inputs)
    if is_finished(out, stage):
        progress.note(f"{out} is finished with these settings: nothing was trained")
        return Policy.load(out / POLICY)

    require_executor(executor, ray_address)
    with working(out, stage):
        training.run(workers, progress, name, executor, ray_address, Checkpoint(out, stage))
        policy = training.policy(
            motors=motors_as_json(motors, out),
            start_sha256=None if start_path is None else digest(start_path),
        )
        policy.save(out / POLICY)
        write_json(out / CURVE, training.curve)
    # after the marker of the finished stage: a run killed before it resumes from the checkpoint
    (out / CHECKPOINT).unlink(missing_ok=True)
    return policy


def _motors_text(motors: MotorSource) -> str:
    """Description of the motors, for the provenance of a policy that is not written to a folder."""
    if isinstance(motors, str):
        return motors
    if isinstance(motors, Printable):
        return motors.overview().headline
    return type(motors).__name__


def _require_other_folder(out: Path, start: Path | None) -> None:
    if start is None or start.resolve() != (out / POLICY).resolve():
        return
    problem = f"start is {POLICY} of the folder out itself, which the training would overwrite"
    raise ConfigError(problem, where=start, remedy="give another folder as out", argument="out")


def weight_warning(policy: Policy, robot: Robot) -> str:
    """The warning if a policy was trained on a robot of another weight; otherwise ""."""
    trained = policy.provenance.get(ROBOT_WEIGHT, robot.weight)
    if abs(trained - robot.weight) <= 0.02 * robot.weight:
        return ""
    masses = f"{trained / GRAVITY:.2f} kg, this {robot.name} has {robot.weight / GRAVITY:.2f} kg"
    remedy = "train it again, or give the robot's earlier model"
    return f"the policy was trained on a robot of {masses} -> {remedy}"


@dataclass(frozen=True)
class Checkpoint:
    """Files from which an interrupted training of the same description continues."""

    folder: Path
    stage: Mapping[str, Any]  # `stage.description` of the training

    def load(self) -> tuple[dict[str, np.ndarray], list[CurvePoint]] | None:
        """State of the search, and learning curve; None if there is no checkpoint of this training.

        ArtifactError if it is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return None
        state, header = read_tensors(path)
        if header.get("wanted") != self.stage:
            return None
        return state, header["curve"]

    def save(self, search: PolicySearch, curve: Sequence[CurvePoint]) -> None:
        """Write the state of the search and the learning curve."""
        # metrics first: after a crash in between, the iteration runs again and writes both again
        lines = [json.dumps(point, sort_keys=True) + "\n" for point in curve]
        write_text(self.folder / METRICS, "".join(lines))
        header = {"wanted": self.stage, "curve": list(curve)}
        write_tensors(self.folder / CHECKPOINT, search.state(), header)


class Training:
    """A training: call `run`, then `policy`.

    See `train_policy` for arguments and errors. ``where`` names the policy ``start`` in errors.
    """

    def __init__(
        self,
        robot: Robot,
        motors: MotorSource,
        settings: WalkSettings,
        start: Policy | None,
        where: str | Path,
    ):
        if start is not None:
            start.require_robot(robot, where)
            robot = robot.with_speed_range(start.forward)
        self.robot = settings.commands.extend_range(robot)
        self.settings = settings
        self.curve = list[CurvePoint]()

        fleet = None
        if settings.validation is not None:
            fleet = load_robot_fleet(robot, settings.validation)
        self._validation = None if fleet is None else fleet.name

        self.motors = simulated_motors(motors, self.robot)
        self._training_scene = self._scene(self.motors)
        self._validation_scene = None
        if fleet is not None:
            self._validation_scene = self._scene(simulated_motors(fleet, self.robot))

        shape = PolicyShape.of(self.robot, settings.hidden_units, settings.symmetric)
        self.search = PolicySearch(settings.search, shape, None if start is None else start.arrays)

    def _scene(self, motors: SimulatedMotors) -> Scene:
        return Scene(self.robot, motors.draw, self.settings, motors.physics_dt)

    def run(
        self,
        workers: int,
        progress: Progress,
        name: str,
        executor: ExecutorName,
        ray_address: str | None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Train ``workers`` episodes at a time, see `make_executor`.

        With a ``checkpoint`` an interrupted training continues to the same bytes.
        """
        require_count("workers", workers)
        self._note_limits(progress)
        if ray_address is None:
            workers = usable_threads(workers, progress)
        search = self.search
        iterations = self.settings.iterations

        with ExitStack() as stack:

            def started(scene: Scene) -> Executor:
                make_simulator = partial(simulator_of, scene)
                new_executor = make_executor(make_simulator, workers, executor, ray_address)
                return stack.enter_context(closing(new_executor))

            trainer = started(self._training_scene)
            evaluator = None
            if self._validation_scene is not None:
                evaluator = started(self._validation_scene)

            if checkpoint is not None:
                self._resume(checkpoint)
            if self.curve:
                progress.note(f"{name}: continues after iteration {search.ars.iteration}")
            task = stack.enter_context(
                progress.start(f"{name}: {iterations} iterations", iterations)
            )
            task.advance(search.ars.iteration)

            def add_point(point: CurvePoint) -> None:
                self._add(point)
                if checkpoint is not None:
                    checkpoint.save(search, self.curve)
                task.advance(1, self._point_text(point))
                if len(self.curve) == FIRST_ITERATIONS:
                    self._require_few_faults()

            search.train(trainer, iterations, evaluator, self.settings.patience, add_point)

        if search.ars.iteration < iterations:
            end = f"{name}: ended after {search.ars.iteration} iterations"
            reason = "the training return does not increase"
            progress.note(f"{end}: {reason}; best policy of {search.best_iteration}")
        self._require_few_faults()
        for fault, count in self._faults().items():
            progress.note(f"{count} of {self._num_episodes()} episodes ended early: {fault}")

    def _note_limits(self, progress: Progress) -> None:
        """Report what limits the result before the training begins."""
        if self.motors.prior is not None:
            for line in prior_notes(self.motors.prior, self.robot):
                progress.note(line)
        if self.robot.fleets and self._validation == self.robot.default_fleet:
            problem = "results on the twin are biased: validation uses its fleet"
            progress.note(f"{problem}; evaluate on another fleet")
        warning = standing_warning(self._training_scene, self.settings.search.seed)
        if warning:
            progress.warn(warning)

    def _add(self, point: CurvePoint) -> None:
        faults = {FAULTS[fault]: count for fault, count in point["faults"].items()}
        self.curve.append(point | {"faults": faults})

    def _point_text(self, point: CurvePoint) -> str:
        upright = 100 * point["mean_steps"] / self.settings.episode_steps
        speed_error = f"speed error {point['mean_speed_error']:.2f} m/s"
        return f"return {point['mean_return']:.2f} m, upright {upright:.0f} %, {speed_error}"

    def _resume(self, checkpoint: Checkpoint) -> None:
        """Restore search and curve if there is a checkpoint; ArtifactError if it is damaged."""
        try:
            saved = checkpoint.load()
            if saved is None:
                return
            state, self.curve = saved
            self.search.restore(state)
            self.search.mean_returns = np.array([point["mean_return"] for point in self.curve])
        except (ArtifactError, KeyError) as error:
            problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
            remedy = "delete it to train from the start"
            where = checkpoint.folder / CHECKPOINT
            raise ArtifactError(problem, where=where, remedy=remedy) from error

    def _faults(self) -> Counter[str]:
        """Number of episodes by fault."""
        return sum((Counter(point["faults"]) for point in self.curve), Counter[str]())

    def _num_episodes(self) -> int:
        return len(self.curve) * 2 * self.settings.search.num_directions

    def _require_few_faults(self) -> None:
        """Raise SimulationFault if the share of episodes with a fault exceeds MAX_FAULTS."""
        faults = self._faults()
        episodes = self._num_episodes()
        if faults.total() <= MAX_FAULTS * episodes:
            return
        counted = f"{faults.total()} of {episodes} episodes"
        problem = f"{counted} had a simulation fault ({', '.join(faults)}): no policy is kept"
        raise SimulationFault(problem, remedy=TOO_STIFF)

    def policy(self, **provenance: Any) -> Policy:
        """The best policy; its provenance has the settings, the result, and ``provenance``."""
        search = self.search
        settings = asdict(self.settings)
        result = {
            "validation": self._validation,
            "iteration": search.best_iteration,
            "best_return": search.best_return,
            ROBOT_WEIGHT: self.robot.weight,
        }
        nominal = self.motors.nominal
        assert nominal is not None, "robots with legs have gains"
        return Policy.of(
            self.robot, search.best, nominal.kp, nominal.kd, **(settings | result | provenance)
        )
