"""How policies walk: numbered walks in a simulated environment, and their mean results.

`compare` gives a tidy table over policies and sets of motors.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import add
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import Fleet
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import Executor, ThreadExecutor
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.progress import PYTHON_WARNINGS, Progress
from motorprior.results import Result, Results
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import (
    MotorSource,
    SimulatedMotors,
    motors_from_json,
    simulated_motors,
)
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import (
    Engine,
    Episode,
    Scene,
    WalkConfig,
    require_walks,
    simulator_of,
)
from motorprior.studies.environments import (
    ENCODER_NOISE,
    NOISY,
    held_out_scene,
    motors_of_walk,
    walk_seed,
)
from motorprior.studies.gait_quality import UNITS, share_upright

DURATION_STEPS = 500  # control steps of a walk of 5 s
NUM_WALKS = 24  # walks of an evaluation
EVALUATION_SEED = 90_000_000  # first seed of an evaluation; seeds of training are hashes
SEED_OF_WALK = partial(add, EVALUATION_SEED)  # number of a walk -> its seed

# axes of `robustness_map`
PUSHES = (0.0, 0.3, 0.6, 0.9)  # largest impulse, every second [N·s]
FRICTIONS = (0.5, 0.75, 1.0, 1.25)  # factor on the friction of the feet
_MAP_WALKS = 4  # walks of each policy per push and friction

ONE_AT_A_TIME = partial(ThreadExecutor, workers=1)


def run_walks(
    scene: Scene,
    policy: PolicyArrays,
    numbers: Sequence[int],
    seed_of: Callable[[int], int] = SEED_OF_WALK,
    motors: Callable[[int], Actuator] | None = None,
    executor: Callable[[Callable[[], Any]], Executor] = ONE_AT_A_TIME,
) -> list[Episode]:
    """Episodes of a policy in a scene, with their traces, one per number.

    ``seed_of`` a walk's number is the seed of its motors, sensors, ground and pushes. ``motors``,
    if given, is a function of the number that gives the motors in place of the scene's. For Ray,
    all arguments must be picklable.
    """
    walks = executor(partial(_Walks, scene, seed_of, motors))
    try:
        return walks.map(_Walks.run, policy, numbers)
    finally:
        walks.close()


class _Walks:
    def __init__(
        self, scene: Scene, seed_of: Callable[[int], int], motors: Callable[[int], Actuator] | None
    ):
        self._number = 0
        self._seed_of = seed_of
        if motors is not None:
            scene = replace(scene, draw_motors=lambda _: motors(self._number))
        self._simulator = simulator_of(scene)

    def run(self, policy: PolicyArrays, number: int) -> Episode:
        self._number = number
        return self._simulator.run(policy, self._seed_of(number), trace=True)

    def close(self) -> None:
        self._simulator.close()


def evaluate(
    policy: Policy,
    scenes: Mapping[str, Scene],
    model: str,
    seed: int,
    num_walks: int = NUM_WALKS,
) -> list[Result]:
    """Walk ``num_walks`` times with a policy in every scene, of DURATION_STEPS.

    ``model`` is the training condition of the policy, ``seed`` the seed of its training. Returns
    rows of the means of speed (forward displacement over the whole time, also after a fall [m/s]),
    upright (share of the time before a fall) and drift (|final lateral displacement| [m]).

    Raises SimulationFault if a walk diverged.
    """
    rows = []
    for name, scene in scenes.items():
        episodes = run_walks(scene, policy.arrays, range(num_walks))
        require_walks(episodes, f"{name}/{model}")

        duration = DURATION_STEPS * scene.robot.control_dt
        forward = np.array([episode.displacement[0] for episode in episodes])
        lateral = [abs(episode.displacement[1]) for episode in episodes]
        values = {
            "speed": np.mean(forward) / duration,
            "upright": _mean_upright(episodes),
            "drift": np.mean(lateral),
        }
        for metric, value in values.items():
            unit = UNITS[metric]
            rows.append(Result(metric, unit, float(value), model, name, seed=seed))
    return rows


def _mean_upright(episodes: Sequence[Episode]) -> float:
    """Mean share of DURATION_STEPS before a fall [-]."""
    return float(np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes]))


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained policy and the simulation in which it was trained, from the record in its file."""

    path: Path  # file of the policy
    robot: Robot  # the robot with the policy's range of speeds
    policy: Policy

    @classmethod
    def load(cls, path: Path, robot: Robot) -> "TrainedPolicy":
        """Read a policy.

        Raises ArtifactError or ConfigError for a damaged file, or another robot or control period.
        """
        policy = Policy.load(path)
        policy.require_robot(robot, path)
        return cls(path, robot.with_speed_range(policy.forward), policy)

    @property
    def motors(self) -> SimulatedMotors:
        """The motors of its training.

        Raises ArtifactError or ConfigError if they are not recorded or their files are missing.
        """
        text = motors_from_json(self.policy.provenance.get("motors"), self.path)
        try:
            return simulated_motors(text, self.robot)
        except (ArtifactError, ConfigError) as error:
            where = self.path if error.where is None else f"{self.path}: {error.where}"
            raise type(error)(
                f"motors of its training: {error.problem}", where=where, remedy=error.remedy
            ) from error

    @property
    def randomization(self) -> Randomization:
        """Randomization of its training; none if the file records none."""
        return Randomization(**self.policy.provenance.get("randomization", {}))

    def scene(self, walk: WalkConfig, engine: Engine | None = None) -> Scene:
        """The simulation of its training, with the episode ``walk``, in another engine if given.

        Raises ArtifactError or ConfigError for missing motors, or an engine that is not installed.
        """
        motors = self.motors
        training_engine = self.policy.provenance.get("engine", "mujoco")
        walk = replace(walk, engine=engine or training_engine)
        return Scene(self.robot, motors.draw, walk, motors.physics_dt)


def with_shared_speeds(robot: Robot, policies: Iterable[Policy]) -> Robot:
    """The robot with the range of speeds that all these policies have."""
    ranges = [policy.forward for policy in policies]
    low = max(low for low, _ in ranges)
    high = min(high for _, high in ranges)
    return robot.with_speed_range((low, high))


def straight_ahead(robot: Robot) -> Commands:
    """Constant forward command at the robot's maximum speed."""
    return Commands.steady(robot.require_gait().forward[1])


def motors_scene(robot: Robot, policy: Policy, motors: MotorSource, commands: Commands) -> Scene:
    """A walk of DURATION_STEPS: on a fleet's twin with encoder noise, or on given motors."""
    robot = robot.with_speed_range(policy.forward)
    walk = WalkConfig(DURATION_STEPS, commands=commands)
    if isinstance(motors, Fleet):
        encoder_noise = Randomization(joint_noise=ENCODER_NOISE)
        return held_out_scene(robot, motors, replace(walk, randomization=encoder_noise))
    simulated = simulated_motors(motors, robot)
    return Scene(robot, simulated.draw, walk, simulated.physics_dt)


def compare(
    robot: Robot | str | Path,
    policies: Mapping[str, Policy | Sequence[Policy]],
    motors: Mapping[str, MotorSource],
    *,
    progress: Progress = PYTHON_WARNINGS,
) -> Results:
    """Evaluate every policy on every set of motors.

    A policy walks 24 times for 5 s, straight ahead at the maximum speed that all policies share.

    Args:
        robot: a robot with legs: its name, the path of its .toml file, or a robot from
            `load_robot`.
        policies: policies by training condition; several policies of a condition are its seeds.
        motors: sets of motors by name. A fleet is evaluated as the held-out twin: unseen motors,
            physics at the robot's ``twin_physics_dt``, and encoder noise. Other motors are
            simulated as in training.
        progress: receives notes and progress.

    Returns:
        Rows of speed [m/s], upright (share of the time before a fall) and drift (final, lateral)
        [m]: means over the samples, one row per quantity, policy and set.

    Raises:
        ConfigError: no policy, no motors, a robot without legs, or policies or motors that do not
            fit it.
        ArtifactError: a robot that cannot be read.
    """
    robot = as_robot(robot)
    robot.require_gait()
    for name, value in (("policies", policies), ("motors", motors)):
        if not value:
            raise ConfigError(f"no {name} given", remedy="give at least one by name", argument=name)

    seeds: dict[str, list[Policy]] = {}
    for name, policy_or_seeds in policies.items():
        if isinstance(policy_or_seeds, Policy):
            seeds[name] = [policy_or_seeds]
        else:
            seeds[name] = list(policy_or_seeds)
        for policy in seeds[name]:
            policy.require_robot(robot, name)
    all_policies = [policy for policies_of_name in seeds.values() for policy in policies_of_name]
    commands = straight_ahead(with_shared_speeds(robot, all_policies))

    rows: list[Result] = []
    count = len(all_policies) * len(motors)
    with progress.start(f"compare: {count} x {NUM_WALKS} walks", count) as task:
        for model, policies_of_name in seeds.items():
            for seed, policy in enumerate(policies_of_name):
                scenes = {}
                for name, source in motors.items():
                    scenes[name] = motors_scene(robot, policy, source, commands)
                rows += evaluate(policy, scenes, model, seed)
                task.advance(len(motors))
    return Results(rows)


def robustness_map(
    policies: Sequence[TrainedPolicy], fleet: Fleet, commands: Commands, study: int
) -> np.ndarray:
    """(pushes, frictions) mean time upright [-] of policies in walks of 5 s.

    All policies walk on the same robots of a fleet. ``study`` is the seed of the study, which
    numbers the robots, see `motors_of_robot`.
    """
    upright = np.zeros((len(PUSHES), len(FRICTIONS)))
    walk = WalkConfig(DURATION_STEPS, commands=commands)
    seed_of_walk = partial(walk_seed, study)
    for trained in policies:
        motors = partial(motors_of_walk, trained.robot, fleet, study, None)
        policy = trained.policy.arrays
        for row, push in enumerate(PUSHES):
            for column, friction in enumerate(FRICTIONS):
                disturbances = replace(NOISY, push=push, friction=(friction, friction))
                scene = held_out_scene(
                    trained.robot, fleet, replace(walk, randomization=disturbances)
                )
                episodes = run_walks(scene, policy, range(_MAP_WALKS), seed_of_walk, motors)
                upright[row, column] += _mean_upright(episodes)
    return upright / len(policies)
