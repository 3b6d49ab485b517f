"""How well policies walk: speed, straightness, feet, falls, on sampled motors and on twins. Tables of docs/training.md.

    python benchmarks/walking.py --out runs/walking

Writes figures.json with PLACE/MEASURE, means over five seeds of 24 draws of 20 s at three speeds each, and
PLACE/MEASURE/SPEED of each speed, where PLACE is sampled (draws of the learned prior, where it was trained), twin
(physical motors, noisy sensors) or hard (a twin with other friction, masses, slope, late sensors and pushes); the same
of the untrained gait, as untrained_PLACE/MEASURE; PLACE/commanded/MEASURE/told … of commands to turn, to go backward,
to stand, and to stop and go (`turning.py`); seconds_to_quarter_meter_per_second and
seconds_to_straight_quarter_meter_per_second, where most seeds got there, and seeds_to_…, the share that did, see
`seconds_to_goal`; and the highest speeds oracle_top_speed, sampled_top_speed and twin_top_speed, see `top_speeds`.
Bench, prior and the five policies are kept; what follows them is computed again. Half an hour on two cores.
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
from motorprior.bench.fleet import Fleet
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice, load_robot_fleet, motor_sampler
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import make_executor
from motorprior.search.policy_search import BestPolicy, new_search, train, updated_best
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.engines import Scene
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import Episode, WalkConfig, WalkSimulator
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.gait_quality import gait_quality, quality_results
from motorprior.transfer.twin import EVALUATION_SEED, HARD, NOISY, twin_of
from turning import TURNS, followed, rows_of, told

PROGRESS = Lines(sys.stderr)
SPEEDS = (0.3, 0.55, 0.8)
"""0.15, 0.275 and 0.4 m/s for the shipped robot."""
PLACES = ("sampled", "twin", "hard")
GOAL_SPEED, GOAL_UPRIGHT, GOAL_COMMAND, GOAL_DRAWS, GOAL_SECONDS = 0.25, 0.98, 0.3, 50, 10.0
GOAL_EVERY, GOAL_ITERATIONS, TOP_UPRIGHT = 5, 100, 0.9
GOAL_HEADING, GOAL_SIDEWAYS = 3.0, 0.05
"""Largest heading error [°/m] and share of the way to the side [-] of a straight walk."""
UNTRAINED = "untrained_"
TOP = 1.5
"""Fastest command of the search for the highest speed, as a share of the robot's usual fastest. At 2.4 the gait trips
over its own start, since a command comes into force within half a second."""


@dataclass(frozen=True)
class Settings:
    """Train on samples of a prior, and watch."""

    out: Path
    """Run folder."""
    robot: str = DEFAULT_ROBOT
    """Robot."""
    fleet: str | None = None
    """Population of motors; the robot's own if not given."""
    speeds: tuple[float, ...] = SPEEDS
    """Commanded speeds, as shares of the robot's fastest."""
    seeds: int = 5
    """Policies."""
    iterations: int = 150
    """Of the search."""
    draws: int = 24
    """Walks per place and speed."""
    seconds: float = 20.0
    """Of a walk [s]."""
    top_iterations: int = 150
    """Of each search for the highest speed; 0 leaves them, and the seconds to the goal, out."""
    hidden_units: int = 0
    """Of the policies; none for linear ones. The goals and highest speeds are those of linear ones."""
    robust: bool = True
    """Vary ground, masses, sensors and pushes in training, too; otherwise motors and commands only."""
    workers: int = 2
    """Threads."""


def prior_of(settings: Settings) -> Path:
    """The prior of the virtual bench."""
    bench, folder = settings.out / "bench", settings.out / "prior"
    run_bench(Bench(bench, settings.fleet, robot=settings.robot), PROGRESS)
    run_identify(Identify(bench, folder), PROGRESS)
    return folder / PRIOR


@dataclass(frozen=True)
class Stage:
    """Where policies are watched: attributes robot, fleet, prior, and how many walk at a time."""

    robot: Robot
    fleet: Fleet
    prior: Path
    workers: int

    def simulator(self, place: str, walk: WalkConfig) -> WalkSimulator:
        """Of one of the three places."""
        if place == "sampled":
            draw, physics_dt = motor_sampler(MotorPrior.load(self.prior), self.robot)
            return WalkSimulator(draw, WorldConfig.of(self.robot, physics_dt=physics_dt), walk)
        return twin_of(self.robot, self.fleet, replace(walk, randomization=NOISY if place == "twin" else HARD))

    def episodes(
        self, place: str, policy: PolicyArrays, commands: Commands | Timetable, draws: int, steps: int
    ) -> list[Episode]:
        """One of every draw, told the same."""
        walk = WalkConfig(steps, commands=commands)
        executor = make_executor(partial(self.simulator, place, walk), self.workers)
        episodes = executor.map(_walk, policy, [EVALUATION_SEED + draw for draw in range(draws)])
        executor.close()
        return episodes

    def walks(self, place: str, policy: PolicyArrays, forward: float, draws: int, seconds: float) -> Results:
        """Measures of every draw at one commanded speed."""
        steps = round(seconds / self.robot.control_dt)
        episodes = self.episodes(place, policy, Commands.steady(forward), draws, steps)
        qualities = [gait_quality(self.robot, each, forward, 0.0, steps) for each in episodes]
        return Results.of(row for each in qualities for row in quality_results(each, self.robot, "walk", place))

    def turns(self, place: str, policy: PolicyArrays, settings: Settings, seed: int) -> Results:
        """How a policy follows commands to turn, to go backward, to stand, and to stop and go."""
        steps, rows = round(settings.seconds / self.robot.control_dt), []
        for name, commands in told(self.robot, settings.seconds).items():
            episodes = self.episodes(place, policy, commands, settings.draws, steps)
            rows += rows_of(place, name, seed, followed(self.robot, episodes, steps))
        return Results.of(rows)

    def watch(self, place: str, policy: PolicyArrays, settings: Settings) -> Results:
        """Means over the draws of every measure, by commanded speed [m/s].

        A fall within two seconds is no way and all error, and has no part in the other means.
        """
        fastest, found = self.robot.require_legs().forward[1], []
        for share in settings.speeds:
            walks = self.walks(place, policy, share * fastest, settings.draws, settings.seconds)
            found += means(walks, f"{share * fastest:.3g}")
        return Results.of(found)


def means(walks: Results, speed: str) -> list[Result]:
    """Means over walks at one speed, which is their part; the lift of a leg is a quantity with the leg's name."""
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
    """The policy of a seed, trained unless it is there."""
    folder = settings.out / f"seed_{seed}"
    motors = MotorChoice("prior", prior=prior)
    run_walk(
        Walk(
            folder, motors, iterations=settings.iterations, search=ArsConfig(seed=seed), workers=settings.workers,
            robot=settings.robot, randomization=ROBUST if settings.robust else Randomization(),
            hidden_units=settings.hidden_units,
        ),
        PROGRESS, f"seed {seed}",
    )  # fmt: skip
    return folder / POLICY


def seconds_to_goal(stage: Stage, seed: int) -> tuple[float, float]:
    """Seconds of training until the best policy walks 0.25 m/s, 98 % upright, on sampled motors; infinite if never.

    The second number counts until it walks straight besides: at most 3 °/m and 5 % of the way aside, in the mean.
    """
    draw, physics_dt = motor_sampler(MotorPrior.load(stage.prior), stage.robot)
    shape = PolicyShape.of(stage.robot, "trot", 0, symmetric=True)
    scene = Scene(stage.robot, "mujoco", draw, physics_dt, WalkConfig(Walk.episode_steps, randomization=ROBUST))
    search, best = new_search(ArsConfig(seed=seed), shape), BestPolicy.none_yet(shape)
    executor, seconds, walking = make_executor(scene.simulator, stage.workers), 0.0, float("inf")
    for iterations in range(0, GOAL_ITERATIONS + 1, GOAL_EVERY):
        began = time.monotonic()
        if iterations == 0:
            best = updated_best(search, shape, executor, best)
        best = train(search, shape, executor, iterations, best)
        seconds += time.monotonic() - began
        rows = stage.walks("sampled", best.policy, GOAL_COMMAND, GOAL_DRAWS, GOAL_SECONDS)
        speed, upright = (rows.mean(quantity=name) for name in ("speed", "upright"))
        heading, aside = (
            rows.mean(quantity=name) if rows.where(quantity=name) else float("inf")  # all fell at once
            for name in ("heading_deg_per_m", "lateral_share")
        )
        PROGRESS.note(
            f"seed {seed}: {seconds:.0f} s, {iterations} iterations: {speed:.2f} m/s, {upright:.0%} upright, "
            f"heading {heading:.1f} °/m, {aside:.1%} aside"
        )
        if speed >= GOAL_SPEED and upright >= GOAL_UPRIGHT:
            walking = min(walking, seconds)
            if heading <= GOAL_HEADING and aside <= GOAL_SIDEWAYS:
                break
    else:
        seconds = float("inf")
    executor.close()
    return walking, seconds


def top_speeds(settings: Settings, stage: Stage) -> list[Result]:
    """Highest speeds of two policies, trained on commands above the robot's usual fastest only.

    One is trained on the twin's physical motors and walks on the twin (oracle_top_speed). The other is trained on draws
    of the prior; it walks on such draws (sampled_top_speed) and on the twin (twin_top_speed). Nothing but motors and
    commands varies in training.
    """
    slowest, usual = stage.robot.require_legs().forward
    robot = stage.robot.with_speeds((slowest, TOP * usual))
    stage = replace(stage, robot=robot)
    walk = WalkConfig(Walk.episode_steps, commands=Commands((usual, TOP * usual), (0.0, 0.0), still=0.0))
    oracle = fast_policy(settings, stage, lambda: twin_of(robot, stage.fleet, walk))
    sampled = fast_policy(settings, stage, partial(stage.simulator, "sampled", walk))
    watched = (("oracle", "twin", oracle), ("sampled", "sampled", sampled), ("twin", "twin", sampled))
    return [Result(f"{name}_top_speed", "m/s", top_speed(stage, place, policy)) for name, place, policy in watched]


def fast_policy(settings: Settings, stage: Stage, simulator: Callable[[], WalkSimulator]) -> PolicyArrays:
    """The best policy of a search on these motors, seed 0."""
    shape = PolicyShape.of(stage.robot, "trot", 0, symmetric=True)
    executor = make_executor(simulator, stage.workers)
    search, best = new_search(ArsConfig(seed=0), shape), BestPolicy.none_yet(shape)
    best = train(search, shape, executor, settings.top_iterations, best)
    executor.close()
    return best.policy


def top_speed(stage: Stage, place: str, policy: PolicyArrays) -> float:
    """Highest mean speed over the commands at which nine of ten draws stay upright [m/s]."""
    speeds, highest = [], stage.robot.require_legs().forward[1]
    for share in np.linspace(0.4, 1.0, 7):
        rows = stage.walks(place, policy, share * highest, GOAL_DRAWS, GOAL_SECONDS)
        speed, upright = (rows.mean(quantity=name) for name in ("speed", "upright"))
        PROGRESS.note(f"top speed, {place}, told {share * highest:.3g} m/s: {speed:.2f} m/s, {upright:.0%} upright")
        speeds.append(speed if upright >= TOP_UPRIGHT else 0.0)
    return max(speeds)


def measure(settings: Settings) -> Results:
    """Everything."""
    robot = load_robot(settings.robot)
    prior = prior_of(settings)
    stage = Stage(robot, load_robot_fleet(robot, settings.fleet), prior, settings.workers)
    found, gait = [], BestPolicy.none_yet(PolicyShape.of(robot, "trot", 0, symmetric=True)).policy
    for place in PLACES:
        found += stage.watch(place, gait, settings).having(motors=UNTRAINED + place, seed=0).rows
    for seed in range(settings.seeds):
        policy = Policy.load(trained(settings, prior, seed)).arrays()
        for place in PLACES:
            watched = stage.watch(place, policy, settings).having(seed=seed)
            found += watched.rows
            for speed in watched.distinct("part"):
                said = ", ".join(f"{row.quantity} {row.value:.3g}" for row in watched.where(part=speed))
                PROGRESS.note(f"seed {seed}, {place}, told {speed} m/s: {said}")
            found += stage.turns(place, policy, settings, seed).rows
    if settings.top_iterations:
        keep(settings, Results.of(found))  # the rest takes long
        found += goals([seconds_to_goal(stage, seed) for seed in range(settings.seeds)])
        found += top_speeds(settings, stage)
    return Results.of(found)


def goals(times: Sequence[tuple[float, float]]) -> Iterator[Result]:
    """Share of the seeds that reached a goal, and the median of their seconds if more than half of them did."""
    for kind, seconds in zip(("", "straight_"), np.transpose(times), strict=True):
        name, median = f"{kind}quarter_meter_per_second", float(np.median(seconds))
        yield Result(f"seeds_to_{name}", "1", float(np.isfinite(seconds).mean()))
        if np.isfinite(median):
            yield Result(f"seconds_to_{name}", "s", median)


def keep(settings: Settings, results: Results) -> None:
    """Write results.json, figures.json and tables.md."""
    results.save(settings.out / "results.json")
    write_json(settings.out / "figures.json", figures_of(results))
    write_text(settings.out / "tables.md", tables(results) + "\n")


def figures_of(results: Results) -> dict[str, float]:
    """PLACE/MEASURE, means over speeds and seeds; the same /SPEED over seeds and /seed_K over speeds."""
    figures: dict[str, float] = {}
    for row in results:
        if row.motors is None:
            figures[row.quantity] = row.value
            continue
        name, here = f"{row.motors}/{row.quantity}", {"quantity": row.quantity, "motors": row.motors}
        figures[f"{name}/{row.part}"] = results.mean(**here, part=row.part)
        if not row.quantity.startswith(TURNS):  # a mean over other commands means nothing
            figures[name] = results.mean(**here)
            figures[f"{name}/seed_{row.seed}"] = results.mean(**here, seed=row.seed)
    return figures


def tables(results: Results) -> str:
    """Markdown: of the policies, of the gait they began with, of turns, and the numbers that are not of walks."""
    walked = Results.of(row for row in results if not row.quantity.startswith(TURNS))
    turns = Results.of(row for row in results if row.quantity.startswith(TURNS))
    numbers = [f"{row.quantity}: {row.value:.3g} {row.unit}" for row in results.where(motors=None)]
    untrained = tuple(UNTRAINED + place for place in PLACES)
    return "\n\n".join([table(walked, PLACES), table(walked, untrained), table(turns, PLACES), *numbers])


def table(results: Results, places: tuple[str, ...]) -> str:
    """Markdown: a row per measure; by command means over the seeds, and the range of the seeds in brackets."""
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
    keep(settings, results)
    print(tables(results))


if __name__ == "__main__":
    main()
