"""How well policies walk on sampled motors and on twins: speed, straightness, feet, falls.

See docs/training.md.

    python benchmarks/walking.py --out runs/walking

figures.json contains
    PLACE/QUANTITY, PLACE/QUANTITY/SPEED   means over five seeds of 24 samples of 20 s, at all three
                                           speeds and at one. PLACE is sampled (samples of the
                                           prior, as in training), twin (physical motors, noisy
                                           sensors) or hard (a twin with other friction, masses,
                                           slope, delayed sensors and pushes)
    untrained_PLACE/QUANTITY               the same for the untrained gait
    PLACE/commanded/QUANTITY/commands …        commands to turn, walk backward and stand (COMMANDS)
    learning/SEARCH/cpu_seconds, /steps        processor time and control steps of a training until
                                           its policy walks, see `learning`; means over seeds,
                                           and /seed_SEED. SEARCH is before or after (SEARCHES)
    learning/ratio/cpu_seconds, /steps         after over before: geometric mean over seeds, with
                                           its 95 % interval /low, /high

Finished benches, priors and policies are reused. Half an hour on two cores; with --draws 0 the
figures of learning only.
"""

import math
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

import motorprior as mp
from figures import PROGRESS, run_benchmark
from motorprior.actuator.fleet import load_robot_fleet
from motorprior.locomotion.ars import AVERAGING
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import ThreadExecutor
from motorprior.locomotion.policy import PolicyArrays
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.priors.fit_prior import PRIOR_FILE
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.scene import Episode, Scene, WalkConfig, simulator_of
from motorprior.studies.compare import run_walks
from motorprior.studies.environments import HARD, NOISY, held_out_scene
from motorprior.studies.gait_quality import (
    WARM_UP,
    completed,
    gait_quality,
    headings,
    share_upright,
)
from motorprior.studies.statistics import mean_interval
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import training_settings

PLACES = ("sampled", "twin", "hard")
TURNS = "commanded/"  # prefix of the names of these quantities
# commanded speed and yaw rate over the robot's fastest; forward and left are positive
COMMANDS = (
    (0.6, 1.0), (0.6, -1.0), (0.0, 1.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.0), (0.1, 0.0),
    (1.0, 0.0), (1.0, 1.0), (1.0, -1.0),
)  # fmt: skip
Rows = Iterator[tuple[str, str, float]]  # quantity, command and mean over the samples
LEARNING_WALKS = 16  # walks of a policy in `learning`
MIN_UPRIGHT = 0.95  # time upright of a policy that walks [-]
MIN_SPEED_SHARE = 0.9  # its speed over the robot's fastest speed [-]
EPISODES_PER_CHECK = 50  # least number of training episodes between two evaluations in `learning`


@dataclass(frozen=True)
class Settings:
    """Train policies on samples of a prior and evaluate them."""

    out: Path  # run folder
    robot: str = DEFAULT_ROBOT  # robot
    fleet: str | None = None  # population of motors; the robot's own if not given
    motors: int = 32  # motors on the bench
    bench_steps: int = 10_000  # samples of each motor's log
    preset: str = "rollout"  # recipe of the prior
    # commanded speeds, as shares of the robot's fastest
    speeds: tuple[float, ...] = (0.3, 0.55, 0.8)
    seeds: int = 5  # policies
    iterations: int = 150  # iterations of a training
    episode_steps: int = 1000  # control steps of a training episode
    draws: int = 24  # walks per environment and speed; 0: only the time to learn
    seconds: float = 20.0  # duration of a walk [s]
    workers: int = 2  # threads


class Search(NamedTuple):
    """A search whose time to learn is measured."""

    num_directions: int
    num_top_directions: int
    step_size: float
    # weight of the newest parameters in their average, constant; None: as `Ars.tell`
    averaging: float | None


SEARCHES = {
    "before": Search(14, 7, 0.03, AVERAGING),  # earlier settings of the study, for comparison
    "after": Search(8, 8, 0.02, None),
}


@dataclass(frozen=True)
class Environments:
    """The three environments in which policies are evaluated (PLACES)."""

    settings: Settings
    robot: mp.Robot
    fleet: mp.Fleet
    prior: mp.MotorPrior
    steps: int  # control steps of a walk

    def episodes(
        self, place: str, policy: PolicyArrays, forward: float, yaw_rate: float = 0.0
    ) -> list[Episode]:
        """One episode per sample, with the same command [m/s, rad/s]."""
        walk = WalkConfig(self.steps, commands=Commands.steady(forward, yaw_rate))
        if place == "sampled":
            motors = simulated_motors(self.prior, self.robot)
            scene = Scene(self.robot, motors.draw, walk, motors.physics_dt)
        else:
            scene = held_out_scene(
                self.robot,
                self.fleet,
                replace(walk, randomization=NOISY if place == "twin" else HARD),
            )
        executor = partial(ThreadExecutor, workers=self.settings.workers)
        return run_walks(scene, policy, range(self.settings.draws), executor=executor)

    def straight(self, place: str, policy: PolicyArrays) -> Rows:
        """All quantities of `gait_quality` by commanded speed [m/s].

        A fall within two seconds counts as zero distance and full error, and is excluded from the
        other means.
        """
        for share in self.settings.speeds:
            forward = share * self.robot.require_gait().forward[1]
            qualities: defaultdict[str, list[float]] = defaultdict(list)
            for episode in self.episodes(place, policy, forward):
                quality = gait_quality(self.robot, episode, forward, 0.0, self.steps)
                for quantity, value in quality.items():
                    qualities[quantity].append(value)
            for quantity, values in qualities.items():
                finite = [value for value in values if math.isfinite(value)]
                if finite:
                    yield quantity, f"{forward:.3g}", float(np.mean(finite))

    def commanded(self, place: str, policy: PolicyArrays) -> Rows:
        """Fraction of walks without a fall at each of COMMANDS, and means over these walks.

        speed_off is the mean |filtered speed - command| [m/s], see `Episode.speed_error`; speed
        [m/s] is the distance along the heading over time, and yaw_rate [rad/s] the turn over time,
        after the first second.
        """
        gait = self.robot.require_gait()
        dt = self.robot.control_dt
        for share, turn in COMMANDS:
            forward = share * (gait.forward[1] if share > 0.0 else -gait.forward[0])
            yaw_rate = turn * gait.yaw_rate
            name = f"commands {forward:.3g} m/s {yaw_rate:.3g} rad/s"
            episodes = self.episodes(place, policy, forward, yaw_rate)
            walks = [episode for episode in episodes if completed(episode, self.steps)]
            yield f"{TURNS}upright", name, len(walks) / len(episodes)
            if not walks:
                continue

            speeds = []
            yaw_rates = []
            for walk in walks:
                quality = gait_quality(self.robot, walk, forward, yaw_rate, self.steps)
                speeds.append(quality["speed"])
                yaw = headings(walk.trace[round(WARM_UP / dt) :])
                yaw_rates.append((yaw[-1] - yaw[0]) / (dt * (len(yaw) - 1)))
            speed_error = float(np.mean([walk.speed_error for walk in walks]))
            yield f"{TURNS}speed_off", name, speed_error
            yield f"{TURNS}speed", name, float(np.mean(speeds))
            yield f"{TURNS}yaw_rate", name, float(np.mean(yaw_rates))


def learning(settings: Settings, robot: mp.Robot, prior: mp.MotorPrior) -> dict[str, float]:
    """Processor time [s] and control steps of trainings until their policy walks.

    Trainings are those of the transfer study on samples of the prior, commanded 1.5 times the
    robot's fastest speed, at which the untrained gait falls. A policy walks if its LEARNING_WALKS
    walks in the training simulation are upright for MIN_UPRIGHT of the time, at MIN_SPEED_SHARE of
    the robot's fastest speed. It is evaluated after every EPISODES_PER_CHECK or more episodes; the
    evaluations do not count. A training that never walks counts whole.
    """
    values: defaultdict[str, list[float]] = defaultdict(list)
    for seed, (name, search) in product(range(settings.seeds), SEARCHES.items()):
        seconds, steps = seconds_to_walk(settings, robot, prior, search, seed)
        PROGRESS.note(f"{name}, seed {seed}: walks after {seconds:.1f} s, {steps} control steps")
        values[f"{name}/cpu_seconds"].append(seconds)
        values[f"{name}/steps"].append(steps)

    figures = {}
    for name, of_seeds in values.items():
        figures[f"learning/{name}"] = float(np.mean(of_seeds))
        for seed, value in enumerate(of_seeds):
            figures[f"learning/{name}/seed_{seed}"] = value

    for quantity in ("cpu_seconds", "steps"):
        logarithms = np.log(values[f"after/{quantity}"]) - np.log(values[f"before/{quantity}"])
        ratio = mean_interval(logarithms)
        name = f"learning/ratio/{quantity}"
        figures[name] = float(np.exp(ratio.value))
        if math.isfinite(ratio.low):  # a single seed has no interval
            figures[f"{name}/low"] = float(np.exp(ratio.low))
            figures[f"{name}/high"] = float(np.exp(ratio.high))
    return figures


def seconds_to_walk(
    settings: Settings, robot: mp.Robot, prior: mp.MotorPrior, search: Search, seed: int
) -> tuple[float, int]:
    """Processor time [s] and control steps of one training until its policy walks."""
    _, fastest = robot.require_gait().forward
    training = training_settings(Study(settings.out, robot=settings.robot), seed)
    robot = training.commands.extend_range(robot)
    motors = simulated_motors(prior, robot)
    scene = Scene(robot, motors.draw, training, motors.physics_dt)

    shape = PolicyShape.of(robot, training.hidden_units, training.symmetric)
    config = replace(
        training.search,
        num_directions=search.num_directions,
        num_top_directions=search.num_top_directions,
        step_size=search.step_size,
    )
    policy_search = PolicySearch(config, shape)
    ars = policy_search.ars
    executor = ThreadExecutor(partial(simulator_of, scene), workers=1)
    run_walks(scene, shape.untrained(), [0])  # compiles the episode
    average = ars.parameters
    cpu_seconds = 0.0
    steps = 0
    unchecked = 0  # episodes since the last evaluation
    for _ in range(settings.iterations):
        begin = time.process_time()
        point = policy_search.advance(executor)
        cpu_seconds += time.process_time() - begin
        steps += round(2 * search.num_directions * point["mean_steps"])
        if search.averaging is None:
            average = ars.average
        else:
            average = average + search.averaging * (ars.parameters - average)

        unchecked += 2 * search.num_directions
        if unchecked >= EPISODES_PER_CHECK:
            unchecked = 0
            walks = run_walks(scene, shape.policy(average, ars.observations), range(LEARNING_WALKS))
            duration = training.episode_steps * robot.control_dt
            speed = float(np.mean([walk.displacement[0] for walk in walks])) / duration
            upright = np.mean([share_upright(walk, training.episode_steps) for walk in walks])
            if upright >= MIN_UPRIGHT and speed >= MIN_SPEED_SHARE * fastest:
                break
    executor.close()
    return cpu_seconds, steps


def compute(settings: Settings) -> dict[str, float]:
    """All figures; the figures straight ahead also over speeds, for all seeds and for each."""
    robot = mp.load_robot(settings.robot)
    folder = settings.out / "prior"
    log = mp.record_bench(
        settings.robot,
        settings.fleet,
        motors=settings.motors,
        steps=settings.bench_steps,
        out=settings.out / "bench",
        progress=PROGRESS,
    )
    prior = mp.fit_prior(log, settings.preset, out=folder, progress=PROGRESS)
    figures = learning(settings, robot, prior)
    if settings.draws == 0:
        return figures

    fleet = load_robot_fleet(robot, settings.fleet)
    steps = round(settings.seconds / robot.control_dt)
    environments = Environments(settings, robot, fleet, prior, steps)
    values_by_name: defaultdict[str, list[float]] = defaultdict(list)

    def add(place: str, rows: Rows, seed: int) -> None:
        for quantity, command, value in rows:
            name = f"{place}/{quantity}"
            names = [f"{name}/{command}"]
            if not quantity.startswith(TURNS):
                names = [name, f"{name}/seed_{seed}", *names]
            for key in names:
                values_by_name[key].append(value)

    for place in PLACES:
        untrained = PolicyShape(robot.num_joints).untrained()
        add(f"untrained_{place}", environments.straight(place, untrained), 0)
    for seed in range(settings.seeds):
        policy = mp.train_policy(
            settings.robot,
            f"prior:{folder / PRIOR_FILE}",
            out=settings.out / f"seed_{seed}",
            seed=seed,
            iterations=settings.iterations,
            episode_steps=settings.episode_steps,
            workers=settings.workers,
            name=f"seed {seed}",
            progress=PROGRESS,
        ).arrays
        for place in PLACES:
            add(place, environments.straight(place, policy), seed)
            add(place, environments.commanded(place, policy), seed)
    for name, values in values_by_name.items():
        figures[name] = float(np.mean(values))
    return figures


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
