"""How well policies walk on sampled motors and on twins: speed, straightness, feet, falls. See docs/training.md.

    python benchmarks/walking.py --out runs/walking

figures.json contains
    PLACE/QUANTITY, PLACE/QUANTITY/SPEED   means over five seeds of 24 samples of 20 s, at all three speeds and at one.
                                           PLACE is sampled (samples of the prior, as in training), twin (physical
                                           motors, noisy sensors) or hard (a twin with other friction, masses, slope,
                                           delayed sensors and pushes)
    untrained_PLACE/QUANTITY               the same for the untrained gait
    PLACE/commanded/QUANTITY/commands …        commands to turn, walk backward and stand (COMMANDS)

Finished benches, priors and policies are reused. Half an hour on two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from figures import report
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import record_bench
from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import ThreadExecutor
from motorprior.locomotion.policy import PolicyArrays
from motorprior.priors.fit_prior import PRIOR, fit_prior
from motorprior.progress import Lines
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.scene import Episode, Scene, WalkConfig
from motorprior.simulation.training import train_policy
from motorprior.stage import FIGURES, RESULTS
from motorprior.studies.compare import run_walks
from motorprior.studies.environments import HARD, NOISY, twin_scene
from motorprior.studies.gait_quality import (
    WARM_UP,
    completed,
    gait_quality,
    headings,
    quality_results,
    steps_along_heading,
)
from untrained import zero_policy

PROGRESS = Lines(sys.stderr)
SPEEDS = (0.3, 0.55, 0.8)  # 0.15, 0.275 and 0.4 m/s for the shipped robot
PLACES = ("sampled", "twin", "hard")
UNTRAINED = "untrained_"
TURNS = "commanded/"  # prefix of the names of these quantities
# commanded speed and yaw rate over the robot's fastest; forward and left are positive
COMMANDS = (
    (0.6, 1.0), (0.6, -1.0), (0.0, 1.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.0), (0.1, 0.0),
    (1.0, 0.0), (1.0, 1.0), (1.0, -1.0),
)  # fmt: skip
UNITS = {"upright": "1", "speed_off": "m/s", "speed": "m/s", "yaw_rate": "rad/s"}


@dataclass(frozen=True)
class Settings:
    """Train policies on samples of a prior and evaluate them."""

    out: Path  # run folder
    robot: str = DEFAULT_ROBOT  # robot
    fleet: str | None = None  # population of motors; the robot's own if not given
    speeds: tuple[float, ...] = SPEEDS  # commanded speeds, as shares of the robot's fastest
    seeds: int = 5  # policies
    iterations: int = 150  # of training
    draws: int = 24  # walks per environment and speed
    seconds: float = 20.0  # of a walk [s]
    workers: int = 2  # threads


@dataclass(frozen=True)
class Environments:
    """The three environments in which policies are evaluated (PLACES)."""

    settings: Settings
    robot: Robot
    fleet: Fleet
    prior: MotorPrior

    @property
    def steps(self) -> int:
        """Control steps of a walk."""
        return round(self.settings.seconds / self.robot.control_dt)

    def episodes(self, place: str, policy: PolicyArrays, commands: Commands) -> list[Episode]:
        """One episode per sample, with the same commands."""
        walk = WalkConfig(self.steps, commands=commands)
        if place == "sampled":
            motors = simulated_motors(self.prior, self.robot)
            scene = Scene(self.robot, motors.draw, walk, motors.physics_dt)
        else:
            scene = twin_scene(self.robot, self.fleet, replace(walk, randomization=NOISY if place == "twin" else HARD))
        executor = partial(ThreadExecutor, workers=self.settings.workers)
        return run_walks(scene, policy, range(self.settings.draws), executor=executor)

    def turns(self, place: str, policy: PolicyArrays, seed: int) -> list[Result]:
        """How a policy follows COMMANDS."""
        rows = []
        for name, commands in command_cases(self.robot).items():
            found = command_errors(self.robot, self.episodes(place, policy, commands), self.steps)
            for quantity, value in found.items():
                rows.append(Result(TURNS + quantity, UNITS[quantity], value, motors=place, part=name, seed=seed))
        return rows

    def evaluate(self, place: str, policy: PolicyArrays) -> Results:
        """Means of all quantities over the samples, by commanded speed [m/s].

        A fall within two seconds counts as zero distance and full error, and is excluded from the other means.
        """
        found = []
        for share in self.settings.speeds:
            forward = share * self.robot.require_gait().forward[1]
            episodes = self.episodes(place, policy, Commands.steady(forward))
            qualities = [gait_quality(self.robot, each, forward, 0.0, self.steps) for each in episodes]
            walks = Results.of(row for each in qualities for row in quality_results(each, "walk", place))
            found += means(walks, f"{forward:.3g}")
        return Results.of(found)


def command_cases(robot: Robot) -> dict[str, Commands]:
    """COMMANDS by their names in figures.json."""
    cases: dict[str, Commands] = {}
    for share, turn in COMMANDS:
        forward, yaw_rate = _speed(robot, share), turn * robot.require_gait().yaw_rate
        cases[f"commands {forward:.3g} m/s {yaw_rate:.3g} rad/s"] = Commands.steady(forward, yaw_rate)
    return cases


def _speed(robot: Robot, share: float) -> float:
    """Speed [m/s] from a fraction of the fastest, forward if positive."""
    slowest, fastest = robot.require_gait().forward
    return share * (fastest if share > 0.0 else -slowest)


def command_errors(robot: Robot, episodes: Sequence[Episode], steps: int) -> dict[str, float]:
    """Fraction of walks without a fall, and means over these walks.

    speed_off is the mean |filtered speed - command| [m/s], see `Episode.speed_error`; speed [m/s] is the distance along
    the heading over time, and yaw_rate [rad/s] the turn over time.
    """
    whole = [each for each in episodes if completed(each, steps)]
    found = {"upright": len(whole) / len(episodes)}
    if whole:
        found["speed_off"] = float(np.mean([each.speed_error for each in whole]))
        rates = [_rates(robot, each) for each in whole]
        found |= dict(zip(("speed", "yaw_rate"), map(float, np.mean(rates, axis=0)), strict=True))
    return found


def _rates(robot: Robot, episode: Episode) -> tuple[float, float]:
    """Speed along the heading [m/s] and yaw rate [rad/s] after the first second."""
    qpos = episode.trace[round(WARM_UP / robot.control_dt) :]
    yaw = headings(qpos)
    time = robot.control_dt * (len(qpos) - 1)
    return float(np.sum(steps_along_heading(qpos[:, :2], yaw))) / time, float(yaw[-1] - yaw[0]) / time


def means(walks: Results, speed: str) -> list[Result]:
    """Means over walks at one speed, which is their ``part``; a quantity of a leg gets the name of the leg."""
    rows = []
    for quantity in walks.distinct("quantity"):
        for leg in walks.where(quantity=quantity).distinct("part"):
            same = walks.where(quantity=quantity, part=leg)
            name = quantity if leg is None else f"{quantity}/{leg}"
            mean = same.mean(quantity=quantity)
            rows.append(replace(same.rows[0], quantity=name, value=mean, model=None, part=speed))
    return rows


def measure(settings: Settings) -> Results:
    """All results."""
    robot, folder = load_robot(settings.robot), settings.out / "prior"
    log = record_bench(settings.robot, settings.fleet, out=settings.out / "bench", progress=PROGRESS)
    prior = fit_prior(log, out=folder, progress=PROGRESS)
    environments = Environments(settings, robot, load_robot_fleet(robot, settings.fleet), prior)
    found, gait = [], zero_policy(robot.num_joints)
    for place in PLACES:
        found += [replace(row, motors=UNTRAINED + place, seed=0) for row in environments.evaluate(place, gait)]
    for seed in range(settings.seeds):
        policy = train_policy(
            settings.robot, f"prior:{folder / PRIOR}", out=settings.out / f"seed_{seed}", seed=seed,
            iterations=settings.iterations, workers=settings.workers, name=f"seed {seed}", progress=PROGRESS,
        ).arrays  # fmt: skip
        for place in PLACES:
            found += [replace(row, seed=seed) for row in environments.evaluate(place, policy)]
            found += environments.turns(place, policy, seed)
    return Results.of(found)


def figures_of(results: Results) -> dict[str, float]:
    """PLACE/QUANTITY, means over speeds and seeds; with /SPEED over seeds, and with /seed_K over speeds."""
    figures: dict[str, float] = {}
    for row in results:
        name, here = f"{row.motors}/{row.quantity}", {"quantity": row.quantity, "motors": row.motors}
        figures[f"{name}/{row.part}"] = results.mean(**here, part=row.part)
        if not row.quantity.startswith(TURNS):
            figures[name] = results.mean(**here)
            figures[f"{name}/seed_{row.seed}"] = results.mean(**here, seed=row.seed)
    return figures


def main() -> None:
    """Measure; write results.json and figures.json; print the figures."""
    settings = tyro.cli(Settings, description=__doc__)
    results = measure(settings)
    results.save(settings.out / RESULTS)
    report(figures_of(results), settings.out / FIGURES)


if __name__ == "__main__":
    main()
