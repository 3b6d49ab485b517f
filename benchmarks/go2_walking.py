"""A Unitree Go2 walks on motors that were identified from its logs.

    python benchmarks/go2_walking.py --data DIR --out runs/go2_walking

DIR has the folders go2 and robots of `real_logs.py`. Policies are trained with the settings of

    motorprior walk --robot go2.toml --motors MOTORS --episode-steps 500 --task.alive 2.5 \
        --search.num-directions 8 --search.num-top-directions 8 --iterations 60

on an ideal PD with the gains of the robot's description, on a PD with friction that is fitted to
the logs and randomised by PD_RANGE, and on samples of the shipped card `go2`. They walk straight
ahead on motors of other distributions than in training: posteriors of a log that the card was not
fitted to, with the units of another leg at every leg of the robot.

figures.json contains CONDITION/ENVIRONMENT/QUANTITY: mean over policies, with the ends /low and
/high of its 90 % interval, a t interval over policies. QUANTITY is upright (share of the time
before a fall [-]) or speed (forward displacement over the whole time [m/s]). CONDITION is a
training condition or untrained. ENVIRONMENT is

    own         the motors of the training, without its disturbances
    other_legs  rigid gears (adapted card), gains of the robot's description, noisy sensors
    hard        the same, with the disturbances of the transfer study; pushes scaled by weight
    log_gains   as other_legs, at the gains of the log
    soft_gears  as other_legs, with soft gears (adapted prior of preset quick)
    pybullet    as other_legs, in PyBullet

Finished priors and policies are reused. Half an hour on two cores.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

import motorprior as mp
from figures import PROGRESS, markdown, run_benchmark
from motor_cards import is_held_out
from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import robot_gains
from motorprior.actuator.registry import DrawMotors, motor_text
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.identification.baselines.pd_fit import WITH_FRICTION, fit_pd
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import TaskWeights
from motorprior.locomotion.executor import ThreadExecutor
from motorprior.locomotion.policy import PolicyArrays
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import Engine, Scene, WalkConfig, require_walks
from motorprior.simulation.training import WalkSettings
from motorprior.studies.compare import run_walks
from motorprior.studies.environments import HARD, NOISY
from motorprior.studies.gait_quality import share_upright
from motorprior.studies.statistics import mean_interval
from real_logs import Settings as RealLogs
from real_logs import imported, robot_file, spread_windows

ROBOT = "go2"
CARD = "go2"
SOFT_PRESET = "quick"  # preset of the prior with soft gears
PD_RANGE = 0.3  # relative range of the constants of the randomised PD
UNTRAINED = "untrained"
QUANTITIES = ("upright", "speed")
INTERVAL = 0.9  # confidence level
# disturbances of the transfer study, with its pushes per weight
HEAVY_PUSH = HARD.push / PUPPER_V2.weight  # [N·s/N]


@dataclass(frozen=True)
class Settings:
    """Train and evaluate the policies."""

    data: Path  # folder with go2/ (raw logs) and robots/ (model)
    out: Path  # run folder
    logs: int | None = None  # number of logs; all if not given
    seconds_of_log: float = 24.0  # total length of the training segments [s]
    policies: int = 3  # policies per condition
    iterations: int = 60  # iterations of a training
    episode_steps: int = 500  # control steps of a training episode
    speed: float = 0.8  # commanded speed of the walks [m/s]
    walks: int = 24  # walks per policy and environment
    seconds: float = 8.0  # duration of a walk [s]
    workers: int = 2  # episodes at a time


def training_settings(settings: Settings, seed: int) -> WalkSettings:
    """Settings of the training of a policy."""
    return WalkSettings(
        episode_steps=settings.episode_steps,
        task=TaskWeights(alive=2.5),  # above twice the fastest command (docs/training.md)
        iterations=settings.iterations,
        search=ArsConfig(num_directions=8, num_top_directions=8, seed=seed),
    )


def motors_of_conditions(log: mp.MotorLog, robot: mp.Robot, folder: Path) -> dict[str, str]:
    """Motors by training condition, as for `walk --motors`."""
    return {
        "ideal_pd": "pd",
        "random_pd": motor_text("pd", spread=PD_RANGE, **pd_constants(log, robot, folder)),
        "card": f"prior:{CARD}",
    }


def pd_constants(log: mp.MotorLog, robot: mp.Robot, folder: Path) -> dict[str, float]:
    """A PD with friction, fitted to a log; its gains are scaled to the robot's description."""
    path = folder / "pd.json"
    if not path.is_file():
        write_json(path, dict(fit_pd(log, WITH_FRICTION).constants))
    constants = read_json(path)

    assert log.gains is not None
    joint = robot.joints[0]
    kp, kd = np.median(log.gains, axis=1)
    return {
        "kp": joint.kp * constants["kp"] / float(kp),
        "kd": joint.kd * constants["kd"] / float(kd),
        "armature": constants["armature"],
        "delay": constants["delay"],
        "coulomb": constants["coulomb"],
    }


@dataclass(frozen=True)
class Environment:
    """Motors and disturbances of walks."""

    robot: mp.Robot
    draw_motors: DrawMotors
    physics_dt: float
    randomization: Randomization = NOISY
    engine: Engine = "mujoco"

    def scene(self, settings: Settings) -> Scene:
        """Walks straight ahead at the commanded speed."""
        walk = WalkConfig(
            num_steps(settings, self.robot),
            randomization=self.randomization,
            commands=Commands.steady(settings.speed),
            engine=self.engine,
        )
        return Scene(self.robot, self.draw_motors, walk, self.physics_dt)


def num_steps(settings: Settings, robot: mp.Robot) -> int:
    """Control steps of a walk."""
    return round(settings.seconds / robot.control_dt)


def held_out_environments(
    robot: mp.Robot, rigid: MotorPosterior, soft: MotorPosterior
) -> dict[str, Environment]:
    """The environments whose motors no policy was trained on."""
    gains = robot_gains(rigid.prior, robot)
    other_legs = Environment(
        robot, partial(motors_of_other_legs, robot, rigid, gains), robot.twin_physics_dt
    )
    pushed = replace(HARD, push=HEAVY_PUSH * robot.weight)
    return {
        "other_legs": other_legs,
        "hard": replace(other_legs, randomization=pushed),
        "log_gains": replace(
            other_legs, draw_motors=partial(motors_of_other_legs, robot, rigid, rigid.gains)
        ),
        "soft_gears": replace(
            other_legs, draw_motors=partial(motors_of_other_legs, robot, soft, gains)
        ),
        "pybullet": replace(other_legs, engine="pybullet"),
    }


def motors_of_other_legs(
    robot: mp.Robot,
    posterior: MotorPosterior,
    gains: np.ndarray | None,
    rng: np.random.Generator,
) -> Actuator:
    """A sample of a posterior, with the units of another leg at every leg."""
    legs = len(robot.legs)
    shift = int(rng.integers(1, legs))
    index = np.zeros(robot.num_joints, dtype=int)
    for number, leg in enumerate(robot.legs):
        index[list(leg.joints)] = robot.legs[(number + shift) % legs].joints
    return posterior.take(index.tolist()).sample(robot.num_joints, rng, gains)


def compute(settings: Settings) -> dict[str, float]:
    """Train the policies, and evaluate them in all environments."""
    real_logs = RealLogs(settings.data, settings.out, logs=settings.logs)
    path = robot_file(real_logs, ROBOT)
    robot = mp.load_robot(path)
    log_paths = imported(real_logs, ROBOT)
    training_logs = []
    held_out_path = log_paths[-1]
    for log_path in log_paths:
        if is_held_out(ROBOT, log_path):
            held_out_path = log_path
        else:
            training_logs.append(read_parquet(log_path))
    training_log = spread_windows(training_logs, settings.seconds_of_log)
    held_out_log = read_parquet(held_out_path)

    posteriors = []
    soft = mp.fit_prior(
        training_log, SOFT_PRESET, out=settings.out / SOFT_PRESET, progress=PROGRESS
    )
    for prior in (mp.from_pretrained(CARD), soft):
        posteriors.append(mp.adapt(prior, held_out_log, allow_outliers=True, progress=PROGRESS))
    environments = held_out_environments(robot, *posteriors)

    values: dict[str, list[float]] = {}
    untrained = PolicyShape(robot.num_joints).untrained()
    add_walks(values, settings, UNTRAINED, untrained, environments)
    conditions = motors_of_conditions(training_log, robot, settings.out)
    for seed, (condition, motors) in product(range(settings.policies), conditions.items()):
        policy = mp.train_policy(
            path,
            motors,
            training_settings(settings, seed),
            out=settings.out / "policies" / f"{condition}_{seed}",
            workers=settings.workers,
            name=f"{condition}, seed {seed}",
            progress=PROGRESS,
        )
        own_motors = simulated_motors(motors, robot)
        own = Environment(robot, own_motors.draw, own_motors.physics_dt)
        # of the training, whose range of commands is larger
        robot_of_policy = robot.with_speed_range(policy.forward)
        all_environments = {}
        for name, environment in {"own": own, **environments}.items():
            all_environments[name] = replace(environment, robot=robot_of_policy)
        add_walks(values, settings, condition, policy.arrays, all_environments)
        PROGRESS.note(table(summary(values)))

    figures = summary(values)
    write_text(settings.out / "table.md", table(figures) + "\n")
    return figures


def add_walks(
    values: dict[str, list[float]],
    settings: Settings,
    condition: str,
    policy: PolicyArrays,
    environments: Mapping[str, Environment],
) -> None:
    """Add the means of a policy's walks in every environment to the values by key."""
    executor = partial(ThreadExecutor, workers=settings.workers)
    for name, environment in environments.items():
        episodes = run_walks(
            environment.scene(settings), policy, range(settings.walks), executor=executor
        )
        require_walks(episodes, f"{condition} in {name}")
        steps = num_steps(settings, environment.robot)
        upright = [share_upright(episode, steps) for episode in episodes]
        distances = [episode.displacement[0] for episode in episodes]
        means = (float(np.mean(upright)), float(np.mean(distances)) / settings.seconds)
        for quantity, mean in zip(QUANTITIES, means, strict=True):
            values.setdefault(f"{condition}/{name}/{quantity}", []).append(mean)


def summary(values: Mapping[str, list[float]]) -> dict[str, float]:
    """Means over policies, with the ends of their intervals if there are several policies."""
    figures = {}
    for name, policies in values.items():
        interval = mean_interval(np.array(policies), INTERVAL)
        figures[name] = interval.value
        if np.isfinite(interval.low):
            is_share = name.endswith("upright")
            figures[f"{name}/low"] = max(0.0, interval.low) if is_share else interval.low
            figures[f"{name}/high"] = min(1.0, interval.high) if is_share else interval.high
    return figures


def table(figures: Mapping[str, float]) -> str:
    """Time upright and speed of every condition, a row per environment."""
    conditions = dict.fromkeys(name.split("/")[0] for name in figures)
    environments = dict.fromkeys(name.split("/")[1] for name in figures)
    rows = []
    for environment in environments:
        cells = [cell(figures, f"{name}/{environment}") for name in conditions]
        rows.append([environment, *cells])
    return markdown(["upright [%], speed [m/s]", *conditions], rows)


def cell(figures: Mapping[str, float], name: str) -> str:
    """Time upright and speed of one condition in one environment."""
    texts = []
    for quantity, factor, digits in (("upright", 100.0, ".0f"), ("speed", 1.0, ".2f")):
        key = f"{name}/{quantity}"
        if key not in figures:
            return ""
        text = f"{factor * figures[key]:{digits}}"
        if f"{key}/low" in figures:
            low = factor * figures[f"{key}/low"]
            high = factor * figures[f"{key}/high"]
            text += f" ({low:{digits}} to {high:{digits}})"
        texts.append(text)
    return ", ".join(texts)


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
