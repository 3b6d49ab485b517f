"""Train a walking policy: settings, the loop, its files, and its provenance."""

import json
import os
from collections import Counter
from collections.abc import Mapping
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
from motorprior.locomotion.executor import ExecutorName, make_executor, require_executor
from motorprior.locomotion.policy import ROBOT_WEIGHT, Policy
from motorprior.locomotion.policy_search import Point, PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.priors.prior_file import prior_notes
from motorprior.progress import SHOWN, Progress, usable_threads
from motorprior.robots.load import as_robot
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.simulation.motors import MotorSource, motors_as_json, simulated_motors
from motorprior.simulation.physics import FAULTS, TOO_STIFF
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.scene import Scene, WalkConfig, simulator_of
from motorprior.stage import description, digest, is_finished, working
from motorprior.texts import Printable


@dataclass(frozen=True)
class WalkSettings(WalkConfig):
    """Settings of a training: of its episodes and of the search."""

    episode_steps: int = 1000
    """Control steps per episode. Policies of short episodes may fall later, from errors that grow slowly."""
    randomization: Randomization = ROBUST
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors, pushes."""
    iterations: int = 200
    """ARS iterations."""
    patience: int | None = None
    """Stop once the mean training return of 10 iterations was no new maximum so many times in a row; never if not
    given."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose physical motors policies are evaluated to choose the best; the motors of
    the training if not given. Not the fleet of a twin on which the policy is tested later."""
    hidden_units: int = 0
    """Hidden units of the policy, an even number if it is symmetric; 0 for a linear one."""
    symmetric: bool = True
    """Mirrored observations give mirrored actions, so that the policy cannot limp to one side."""
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
    progress: Progress = SHOWN,
    **changes: Any,
) -> Policy:
    """Train a walking policy by augmented random search, on motors sampled for every episode.

    Args:
        robot: with legs: a name, the path of a .toml file, or a robot from `load_robot`.
        motors: a text such as "prior:FILE" or "pd:kp=9" (`actuator.registry`); a prior, a posterior
            or a fleet to sample from; fixed motors; or a function that samples them with a
            generator.
        settings: of the training.
        start: a policy to continue from; the untrained gait if not given. The result is never worse
            on the same motors.
        out: folder for policy.safetensors, curve.json and metrics.jsonl, which the same call loads;
            an interrupted training continues there. It needs motors, and a start, of files: a text,
            and a path.
        workers: episodes at a time, on which the result does not depend; up to two if not given.
        executor: threads of this process, or Ray processes, on which the result does not depend.
        ray_address: a running Ray cluster for the executor ray; Ray starts on this machine if not
            given.
        name: of the training, in its progress.
        progress: where to report to.
        changes: fields of `WalkSettings`, such as iterations; ``seed`` is that of the search.

    Returns:
        The best policy of all evaluations.

    Raises:
        ConfigError: a robot without legs, motors that do not fit it, a number out of range, a start
            of another shape, or symmetry of a robot that has none.
        ArtifactError: a robot or a validation fleet that cannot be read.
        SimulationFault: most episodes had one.
    """
    robot = as_robot(robot)
    settings = settings or WalkSettings()
    seed = changes.pop("seed", None)
    settings = replace(settings, **changes)
    if seed is not None:
        settings = replace(settings, search=replace(settings.search, seed=seed))
    path, given = (
        (Path(start), Policy.load(start)) if isinstance(start, str | Path) else (None, start)
    )
    training = Training(robot, motors, settings, given, path or "start")
    run = partial(
        training.run,
        min(2, os.cpu_count() or 1) if workers is None else workers,
        progress,
        name,
        executor,
    )
    if out is None:
        run(ray_address)
        described = (
            motors.overview().headline if isinstance(motors, Printable) else type(motors).__name__
        )
        return training.policy(motors=motors if isinstance(motors, str) else described)
    out = Path(out)
    if not isinstance(motors, str) or isinstance(start, Policy):
        raise ConfigError(
            "out needs motors and start of files", remedy="give a text and a path", argument="out"
        )
    if path is not None and path.resolve() == (out / POLICY).resolve():
        problem = f"start is {POLICY} of the folder out itself, which the training would overwrite"
        raise ConfigError(problem, where=path, remedy="give another folder as out", argument="out")
    inputs = [*training.motors.files, *robot.files, *([] if path is None else [path])]
    inputs += [] if settings.validation is None else fleet_files(robot, settings.validation)
    wanted = description("walk", asdict(settings) | {"motors": motors, "robot": robot.name}, inputs)
    if is_finished(out, wanted):
        progress.note(f"{out} is finished with these settings: nothing was trained")
        return Policy.load(out / POLICY)
    require_executor(executor, ray_address)
    with working(out, wanted):
        run(ray_address, (out, wanted))
        start_sha256 = None if path is None else digest(path)
        policy = training.policy(motors=motors_as_json(motors, out), start_sha256=start_sha256)
        policy.save(out / POLICY)
        write_json(out / CURVE, training.curve)
    # after the marker: a run killed before resumes from it
    (out / CHECKPOINT).unlink(missing_ok=True)
    return policy


# share of episodes with faults; iterations after which it is checked, too
MAX_FAULTS = 0.5
FIRST_ITERATIONS = 5
# files in the folder of a training
POLICY = "policy.safetensors"
CURVE = "curve.json"
CHECKPOINT = "search.safetensors"
METRICS = "metrics.jsonl"


def weight_warning(policy: Policy, robot: Robot) -> str:
    """Text of the warning if a policy was trained on a robot of another weight, otherwise empty."""
    trained = policy.provenance.get(ROBOT_WEIGHT, robot.weight)
    if abs(trained - robot.weight) <= 0.02 * robot.weight:
        return ""
    masses = f"{trained / GRAVITY:.2f} kg, this {robot.name} has {robot.weight / GRAVITY:.2f} kg"
    remedy = "train it again, or give the robot's earlier model"
    return f"the policy was trained on a robot of {masses} -> {remedy}"


class Training:
    """A training: call `run`, then `policy`. See `train_policy` for arguments and errors; ``where`` names ``start``."""

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
        self.curve = list[Point]()
        fleet = (
            None if settings.validation is None else load_robot_fleet(robot, settings.validation)
        )
        self._validation = None if fleet is None else fleet.name
        self.motors = simulated_motors(motors, self.robot)
        drawn = (
            [self.motors] if fleet is None else [self.motors, simulated_motors(fleet, self.robot)]
        )
        scenes = [Scene(self.robot, each.draw, settings, each.physics_dt) for each in drawn]
        # of training, and of a validation fleet
        self._simulators = [partial(simulator_of, scene) for scene in scenes]
        shape = PolicyShape.of(self.robot, settings.hidden_units, settings.symmetric)
        self.search = PolicySearch(settings.search, shape, None if start is None else start.arrays)

    def run(
        self,
        workers: int,
        progress: Progress,
        name: str,
        executor: ExecutorName,
        ray_address: str | None,
        files: tuple[Path, Mapping[str, Any]] | None = None,
    ) -> None:
        """Train ``workers`` episodes at a time, see `make_executor`.

        With ``files``, the folder of the checkpoint and the `stage.description`, an interrupted
        training of this description continues to the same bytes.
        """
        require_count("workers", workers)
        for line in [] if self.motors.prior is None else prior_notes(self.motors.prior, self.robot):
            progress.note(line)
        if self.robot.fleets and self._validation == self.robot.default_fleet:
            progress.note(
                "results on the twin are biased: validation uses its fleet; evaluate on another fleet"
            )
        workers = workers if ray_address is not None else usable_threads(workers, progress)
        search = self.search
        settings = self.settings
        with ExitStack() as stack:
            executors = (
                make_executor(each, workers, executor, ray_address) for each in self._simulators
            )
            train, *evaluate = (stack.enter_context(closing(each)) for each in executors)
            if files is not None:
                self._resume(*files)
            if self.curve:
                progress.note(f"{name}: continues after iteration {search.ars.iteration}")
            total = settings.iterations
            task = stack.enter_context(progress.start(f"{name}: {total} iterations", total))
            task.advance(search.ars.iteration)

            def report(point: Point) -> None:
                faults = {FAULTS[fault]: count for fault, count in point["faults"].items()}
                self.curve.append(point | {"faults": faults})
                if files is not None:
                    self._save(*files)
                upright = 100 * point["mean_steps"] / settings.episode_steps
                speed_error = f"speed error {point['mean_speed_error']:.2f} m/s"
                task.advance(
                    1,
                    f"return {point['mean_return']:.2f} m, upright {upright:.0f} %, {speed_error}",
                )
                if len(self.curve) == FIRST_ITERATIONS:
                    self._faults()

            search.train(train, total, evaluate[0] if evaluate else None, settings.patience, report)
        if search.ars.iteration < total:
            ended = f"{name}: ended after {search.ars.iteration} iterations"
            progress.note(
                f"{ended}: the training return does not increase; best policy of {search.best_iteration}"
            )
        faults, episodes = self._faults()
        for fault, count in faults.items():
            progress.note(f"{count} of {episodes} episodes ended early: {fault}")

    def _resume(self, folder: Path, wanted: Mapping[str, Any]) -> None:
        """Restore search and curve from the checkpoint, if any; ArtifactError if it is damaged."""
        path = folder / CHECKPOINT
        if path.is_file():
            try:
                state, header = read_tensors(path)
                if header.get("wanted") == wanted:
                    self.search.restore(state)
                    self.curve = header["curve"]
                    self.search.mean_returns = np.array(
                        [point["mean_return"] for point in self.curve]
                    )
            except (ArtifactError, KeyError) as error:
                problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
                raise ArtifactError(
                    problem, where=path, remedy="delete it to train from the start"
                ) from error

    def _save(self, folder: Path, wanted: Mapping[str, Any]) -> None:
        # metrics first: after a crash in between, the iteration runs again and writes both again
        write_text(
            folder / METRICS,
            "".join(json.dumps(point, sort_keys=True) + "\n" for point in self.curve),
        )
        write_tensors(
            folder / CHECKPOINT, self.search.state(), {"wanted": wanted, "curve": self.curve}
        )

    def _faults(self) -> tuple[Counter[str], int]:
        """Episodes by fault, and all episodes; SimulationFault if the share with one, no fall, exceeds MAX_FAULTS."""
        faults = sum((Counter(point["faults"]) for point in self.curve), Counter[str]())
        episodes = len(self.curve) * 2 * self.settings.search.num_directions
        if faults.total() > MAX_FAULTS * episodes:
            problem = f"{faults.total()} of {episodes} episodes had a simulation fault ({', '.join(faults)})"
            raise SimulationFault(f"{problem}: no policy is kept", remedy=TOO_STIFF)
        return faults, episodes

    def policy(self, **provenance: Any) -> Policy:
        """The best policy; ``provenance`` joins the settings."""
        search = self.search
        settings = asdict(self.settings)
        nominal = self.motors.nominal
        found = {
            "validation": self._validation,
            "iteration": search.best_iteration,
            "best_return": search.best_return,
        }
        found |= {ROBOT_WEIGHT: self.robot.weight}
        return Policy.of(
            self.robot, search.best, nominal.kp, nominal.kd, **(settings | found | provenance)
        )
