"""How well policies walk on sampled motors and on twins: speed, straightness, feet, falls. Tables of docs/training.md.

    python benchmarks/walking.py --out runs/walking

figures.json contains
    PLACE/QUANTITY, PLACE/QUANTITY/SPEED   means over five seeds of 24 samples of 20 s, at all three speeds and at one.
                                           PLACE is sampled (samples of the prior, as in training), twin (physical
                                           motors, noisy sensors) or hard (a twin with other friction, masses, slope,
                                           delayed sensors and pushes)
    untrained_PLACE/QUANTITY               the same for the untrained gait
    PLACE/commanded/QUANTITY/told …        commands to turn, walk backward, stand, stop and go (`turning.py`)
    seconds_to_…, seeds_to_…               training time to 0.25 m/s if most seeds reach it, and the fraction that does,
                                           see `seconds_to_goal`
    oracle_/sampled_/twin_top_speed        maximum speeds, see `top_speeds`

Finished benches, priors and policies are reused. Half an hour on two cores.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_json, write_text
from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.identification.fit_prior import PRIOR
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.executor import make_executor
from motorprior.locomotion.policy import Policy, PolicyArrays, zero_policy
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.progress import Lines
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.scene import Episode, Scene, WalkConfig, WalkSimulator
from motorprior.studies.compare import EVALUATION_SEED
from motorprior.studies.environments import HARD, NOISY, twin_scene
from motorprior.studies.gait_quality import gait_quality, quality_results
from turning import TURNS, command_cases, command_errors, command_results

PROGRESS = Lines(sys.stderr)
SPEEDS = (0.3, 0.55, 0.8)  # 0.15, 0.275 and 0.4 m/s for the shipped robot
PLACES = ("sampled", "twin", "hard")
GOAL_SPEED, GOAL_UPRIGHT, GOAL_COMMAND, GOAL_DRAWS, GOAL_SECONDS = 0.25, 0.98, 0.3, 50, 10.0
GOAL_EVERY, GOAL_ITERATIONS, TOP_UPRIGHT = 5, 100, 0.9
GOAL_HEADING, GOAL_SIDEWAYS = 3.0, 0.05  # maximum heading error [°/m] and lateral share [-] of a straight walk
UNTRAINED = "untrained_"
TOP = 1.5  # maximum command over the robot's usual maximum, for the top speed; at 2.4 the gait falls at the start


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
    top_iterations: int = 150  # of training for the top speed; 0 skips the top speeds and the training times
    hidden_units: int = 0  # of the policies; 0: linear. Training times and top speeds are those of linear policies
    robust: bool = True  # randomise ground, masses, sensors and pushes in training; otherwise motors and commands only
    workers: int = 2  # threads


def prior_of(settings: Settings) -> Path:
    """Prior identified from the virtual bench."""
    bench, folder = settings.out / "bench", settings.out / "prior"
    run_bench(Bench(bench, settings.fleet, robot=settings.robot), PROGRESS)
    run_identify(Identify(bench, folder), PROGRESS)
    return folder / PRIOR


@dataclass(frozen=True)
class Environments:
    """The three environments in which policies are evaluated (PLACES)."""

    robot: Robot
    fleet: Fleet
    prior: Path
    workers: int

    def simulator(self, place: str, walk: WalkConfig) -> WalkSimulator:
        """Simulator of one environment, or of the twin's motors as in training ("oracle")."""
        if place == "sampled":
            motors = simulated_motors(MotorPrior.load(self.prior), self.robot)
            return WalkSimulator(Scene(self.robot, motors.draw, walk, motors.physics_dt))
        if place != "oracle":
            walk = replace(walk, randomization=NOISY if place == "twin" else HARD)
        return WalkSimulator(twin_scene(self.robot, self.fleet, walk))

    def episodes(
        self, place: str, policy: PolicyArrays, commands: Commands | Timetable, draws: int, steps: int
    ) -> list[Episode]:
        """One episode per sample, with the same commands."""
        walk = WalkConfig(steps, commands=commands)
        executor = make_executor(partial(self.simulator, place, walk), self.workers)
        episodes = executor.map(_walk, policy, [EVALUATION_SEED + draw for draw in range(draws)])
        executor.close()
        return episodes

    def walks(self, place: str, policy: PolicyArrays, forward: float, draws: int, seconds: float) -> Results:
        """Gait quality of every sample at one commanded speed."""
        steps = round(seconds / self.robot.control_dt)
        episodes = self.episodes(place, policy, Commands.steady(forward), draws, steps)
        qualities = [gait_quality(self.robot, each, forward, 0.0, steps) for each in episodes]
        return Results.of(row for each in qualities for row in quality_results(each, "walk", place))

    def turns(self, place: str, policy: PolicyArrays, settings: Settings, seed: int) -> Results:
        """How a policy follows the commands of `turning`."""
        steps, rows = round(settings.seconds / self.robot.control_dt), []
        for name, commands in command_cases(self.robot, settings.seconds).items():
            episodes = self.episodes(place, policy, commands, settings.draws, steps)
            rows += command_results(place, name, seed, command_errors(self.robot, episodes, steps))
        return Results.of(rows)

    def evaluate(self, place: str, policy: PolicyArrays, settings: Settings) -> Results:
        """Means of all quantities over the samples, by commanded speed [m/s].

        A fall within two seconds counts as zero distance and full error, and is excluded from the other means.
        """
        fastest, found = self.robot.require_legs().forward[1], []
        for share in settings.speeds:
            walks = self.walks(place, policy, share * fastest, settings.draws, settings.seconds)
            found += means(walks, f"{share * fastest:.3g}")
        return Results.of(found)


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


def _walk(simulator: WalkSimulator, policy: PolicyArrays, seed: int) -> Episode:
    return simulator.run(policy, seed, trace=True)


def trained(settings: Settings, prior: Path, seed: int) -> Path:
    """The policy of a seed; trained if the file does not exist."""
    folder = settings.out / f"seed_{seed}"
    run_walk(
        Walk(
            out=folder, motors=f"prior:{prior}", iterations=settings.iterations, search=ArsConfig(seed=seed),
            workers=settings.workers,
            robot=settings.robot, randomization=ROBUST if settings.robust else Randomization(),
            hidden_units=settings.hidden_units,
        ),
        PROGRESS, f"seed {seed}",
    )  # fmt: skip
    return folder / POLICY


def seconds_to_goal(environments: Environments, seed: int) -> tuple[float, float]:
    """Training time until the best policy walks at 0.25 m/s, 98 % upright, on sampled motors [s]; infinite if never.

    The second number is the time until it also walks straight: mean heading error <= 3 °/m, lateral share <= 5 %.
    """
    motors = simulated_motors(MotorPrior.load(environments.prior), environments.robot)
    shape = PolicyShape.of(environments.robot, "trot", 0, symmetric=True)
    scene = Scene(
        environments.robot, motors.draw, WalkConfig(Walk.episode_steps, randomization=ROBUST), motors.physics_dt
    )
    search = PolicySearch(ArsConfig(seed=seed), shape)
    executor, seconds, walking = make_executor(partial(WalkSimulator, scene), environments.workers), 0.0, float("inf")
    for iterations in range(0, GOAL_ITERATIONS + 1, GOAL_EVERY):
        began = time.monotonic()
        search.train(executor, iterations)
        seconds += time.monotonic() - began
        rows = environments.walks("sampled", search.best, GOAL_COMMAND, GOAL_DRAWS, GOAL_SECONDS)
        speed, upright = (rows.mean(quantity=name) for name in ("speed", "upright"))
        heading, aside = (
            rows.mean(quantity=name) if rows.where(quantity=name) else float("inf")  # all fell within two seconds
            for name in ("heading_deg_per_m", "lateral_share")
        )
        PROGRESS.note(
            f"seed {seed}: {seconds:.0f} s, {iterations} iterations: {speed:.2f} m/s, {upright:.0%} upright, "
            f"heading {heading:.1f} °/m, {aside:.1%} lateral"
        )
        if speed >= GOAL_SPEED and upright >= GOAL_UPRIGHT:
            walking = min(walking, seconds)
            if heading <= GOAL_HEADING and aside <= GOAL_SIDEWAYS:
                break
    else:
        seconds = float("inf")
    executor.close()
    return walking, seconds


def top_speeds(settings: Settings, environments: Environments) -> list[Result]:
    """Maximum speeds of two policies trained only on commands above the robot's usual range.

    One is trained and tested on the twin's physical motors (oracle_top_speed). The other is trained on samples of the
    prior and tested on samples (sampled_top_speed) and on the twin (twin_top_speed). Training randomises only motors
    and commands.
    """
    slowest, usual = environments.robot.require_legs().forward
    robot = environments.robot.with_speed_range((slowest, TOP * usual))
    environments = replace(environments, robot=robot)
    walk = WalkConfig(Walk.episode_steps, commands=Commands((usual, TOP * usual), (0.0, 0.0), still=0.0))
    oracle = fast_policy(settings, environments, partial(environments.simulator, "oracle", walk))
    sampled = fast_policy(settings, environments, partial(environments.simulator, "sampled", walk))
    tested = (("oracle", "twin", oracle), ("sampled", "sampled", sampled), ("twin", "twin", sampled))
    return [
        Result(f"{name}_top_speed", "m/s", top_speed(environments, place, policy)) for name, place, policy in tested
    ]


def fast_policy(settings: Settings, environments: Environments, simulator: Callable[[], WalkSimulator]) -> PolicyArrays:
    """The best policy of a training in this simulator, seed 0."""
    shape = PolicyShape.of(environments.robot, "trot", 0, symmetric=True)
    executor = make_executor(simulator, environments.workers)
    search = PolicySearch(ArsConfig(seed=0), shape)
    search.train(executor, settings.top_iterations)
    executor.close()
    return search.best


def top_speed(environments: Environments, place: str, policy: PolicyArrays) -> float:
    """Maximum mean speed over the commands with which 90 % of the samples stay upright [m/s]."""
    speeds, highest = [], environments.robot.require_legs().forward[1]
    for share in np.linspace(0.4, 1.0, 7):
        rows = environments.walks(place, policy, share * highest, GOAL_DRAWS, GOAL_SECONDS)
        speed, upright = (rows.mean(quantity=name) for name in ("speed", "upright"))
        PROGRESS.note(
            f"top speed, {place}, commanded {share * highest:.3g} m/s: {speed:.2f} m/s, {upright:.0%} upright"
        )
        speeds.append(speed if upright >= TOP_UPRIGHT else 0.0)
    return max(speeds)


def measure(settings: Settings) -> Results:
    """All results."""
    robot = load_robot(settings.robot)
    prior = prior_of(settings)
    environments = Environments(robot, load_robot_fleet(robot, settings.fleet), prior, settings.workers)
    found, gait = [], zero_policy(robot.num_joints)
    for place in PLACES:
        found += environments.evaluate(place, gait, settings).having(motors=UNTRAINED + place, seed=0).rows
    for seed in range(settings.seeds):
        policy = Policy.load(trained(settings, prior, seed)).arrays
        for place in PLACES:
            evaluated = environments.evaluate(place, policy, settings).having(seed=seed)
            found += evaluated.rows
            for speed in evaluated.distinct("part"):
                values = ", ".join(f"{row.quantity} {row.value:.3g}" for row in evaluated.where(part=speed))
                PROGRESS.note(f"seed {seed}, {place}, commanded {speed} m/s: {values}")
            found += environments.turns(place, policy, settings, seed).rows
    if settings.top_iterations:
        write(settings, Results.of(found))  # the rest takes long
        found += goals([seconds_to_goal(environments, seed) for seed in range(settings.seeds)])
        found += top_speeds(settings, environments)
    return Results.of(found)


def goals(times: Sequence[tuple[float, float]]) -> Iterator[Result]:
    """Fraction of the seeds that reach a goal, and the median training time if more than half of them do."""
    for kind, seconds in zip(("", "straight_"), np.transpose(times), strict=True):
        name, median = f"{kind}quarter_meter_per_second", float(np.median(seconds))
        yield Result(f"seeds_to_{name}", "1", float(np.isfinite(seconds).mean()))
        if np.isfinite(median):
            yield Result(f"seconds_to_{name}", "s", median)


def write(settings: Settings, results: Results) -> None:
    """Write results.json, figures.json and tables.md."""
    results.save(settings.out / "results.json")
    write_json(settings.out / "figures.json", figures_of(results))
    write_text(settings.out / "tables.md", tables(results) + "\n")


def figures_of(results: Results) -> dict[str, float]:
    """PLACE/QUANTITY, means over speeds and seeds; with /SPEED over seeds, and with /seed_K over speeds."""
    figures: dict[str, float] = {}
    for row in results:
        if row.motors is None:
            figures[row.quantity] = row.value
            continue
        name, here = f"{row.motors}/{row.quantity}", {"quantity": row.quantity, "motors": row.motors}
        figures[f"{name}/{row.part}"] = results.mean(**here, part=row.part)
        if not row.quantity.startswith(TURNS):
            figures[name] = results.mean(**here)
            figures[f"{name}/seed_{row.seed}"] = results.mean(**here, seed=row.seed)
    return figures


def tables(results: Results) -> str:
    """Markdown tables of the policies, of the untrained gait and of turns, and the other numbers."""
    walked = Results.of(row for row in results if not row.quantity.startswith(TURNS))
    turns = Results.of(row for row in results if row.quantity.startswith(TURNS))
    numbers = [f"{row.quantity}: {row.value:.3g} {row.unit}" for row in results.where(motors=None)]
    untrained = tuple(UNTRAINED + place for place in PLACES)
    return "\n\n".join([table(walked, PLACES), table(walked, untrained), table(turns, PLACES), *numbers])


def table(results: Results, places: tuple[str, ...]) -> str:
    """Markdown: one row per quantity; means over the seeds by command, with the range of the seeds in brackets."""
    walked = results.where(motors=places)
    columns = [(place, speed) for place in places for speed in walked.distinct("part")]
    heads = [f"{place}, {speed}{'' if speed.startswith('told') else ' m/s'}" for place, speed in columns]
    lines = ["| measure | " + " | ".join(heads) + " |", "|---|" + "---|" * len(heads)]
    for quantity in walked.distinct("quantity"):
        cells = []
        for place, speed in columns:
            values = [row.value for row in walked.where(quantity=quantity, motors=place, part=speed)]
            cells.append(f"{np.mean(values):.2g} ({min(values):.2g}-{max(values):.2g})" if values else "")
        unit = walked.where(quantity=quantity).rows[0].unit
        lines.append(f"| {quantity}{'' if unit == '1' else f' [{unit}]'} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, write, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    results = measure(settings)
    write(settings, results)
    print(tables(results))


if __name__ == "__main__":
    main()
