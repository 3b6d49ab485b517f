"""Searches for a walking policy, side by side: return, time and transfer.

    pip install 'motorprior[optimisers]'
    python benchmarks/optimisers.py --prior runs/prior/prior.safetensors --out runs/optimisers

ARS V1, V1-t, V2, V2-t, diagonal CMA-ES (pycma), PGPE with ClipUp (EvoTorch) and PPO (Stable-Baselines3) train on the
same task, that of `motorprior transfer --study`: straight on, half as fast again as the robot usually walks, on draws
of the prior. The searches walk the same number of episodes, with linear policies that answer a mirrored observation
with the mirrored action; both candidates of a pair of ARS and PGPE meet the same motors, and all of an iteration of
CMA-ES; PPO takes as many steps as these episodes have where nobody falls, with a layer of tanh and no
symmetry. Every tenth iteration the running average of a search's center challenges the best so far, on the same draws
for all; PPO's policy does likewise. The policies are watched as in the study. Writes walks.csv, figures.json with
METHOD/PLACE/MEASURE, METHOD/seconds and METHOD/return (of the contests, of the policy that is kept), and tables.md.
Finished policies are kept. PyTorch is a gigabyte; `--methods` picks some.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from motorprior.artifacts import write_json, write_text
from motorprior.bounds import require_count
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.pipeline.stage import locked
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.stage import description, is_finished, remove, seconds_of, working
from motorprior.pipeline.stopwatch import UNFINISHED
from motorprior.pipeline.transfer_study.condition import Condition
from motorprior.pipeline.transfer_study.study_settings import Study
from motorprior.pipeline.transfer_study.study_watch import twins_here, watched
from motorprior.pipeline.walking.motor_provenance import choice_as_json
from motorprior.pipeline.walking.trained_policy import policy_of
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import AVERAGING, ArsConfig
from motorprior.search.executor import Executor, make_executor
from motorprior.search.moments import Moments
from motorprior.search.policy_search import (
    CONTEST,
    CONTEST_DRAWS,
    CONTEST_EVERY,
    Champion,
    EpisodeLike,
    episode_seed,
)
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.engines import Scene
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.transfer.statistics import estimate
from motorprior.transfer.study_results import with_interval
from motorprior.transfer.study_verdicts import MEASURES as UNITS
from motorprior.transfer.study_verdicts import statistic_of
from motorprior.transfer.walk_table import WalkTable
from searches import Cma, Pgpe, Ppo, Search

PROGRESS = Lines(sys.stderr)
POPULATION, EPISODE_STEPS = 32, 500
ARS = {
    "ars_v1": {"normalise": False, "num_top_directions": POPULATION // 2},
    "ars_v1t": {"normalise": False},
    "ars_v2": {"num_top_directions": POPULATION // 2},
    "ars_v2t": {},
}
"""Settings of the search that are not the default."""
SEARCHES: dict[str, Callable[[int, int, int], Search]] = {"cma": Cma, "pgpe": Pgpe}
PPO = "ppo"
"""Name of the method that is no search."""
METHODS = (*ARS, *SEARCHES, PPO)
MEASURES = ("speed", "upright", "drift")


@dataclass(frozen=True)
class Settings:
    """Train with every method, and watch."""

    prior: Path
    """Prior whose motors are drawn."""
    out: Path
    """Run folder."""
    methods: tuple[str, ...] = METHODS
    """Names of methods."""
    seeds: int = 5
    """Policies per method."""
    iterations: int = 50
    """Of a search, of 32 episodes each; PPO takes as many steps."""
    draws: int = 32
    """Walks of each policy at each place."""
    workers: int = 2
    """Threads of a search; PPO has one."""

    @property
    def study(self) -> Study:
        """How policies are watched."""
        return Study(self.out, seeds=self.seeds, draws=self.draws, iterations=self.iterations, workers=self.workers)


@dataclass(frozen=True)
class Walker:
    """The task.

    Attributes:
        settings: of the benchmark.
        robot: told the speed.
        motors: draws of the prior.
        walk: an episode.
        shape: of a linear policy.
    """

    settings: Settings
    robot: Robot
    motors: MotorChoice
    walk: WalkConfig
    shape: PolicyShape

    @classmethod
    def of(cls, settings: Settings) -> Walker:
        """The study's."""
        robot = load_robot(settings.study.robot)
        commands = settings.study.commands(robot)
        robot, motors = commands.on(robot), MotorChoice("prior", settings.prior)
        return cls(
            settings, robot, motors, WalkConfig(EPISODE_STEPS, commands=commands),
            PolicyShape.of(robot, "trot", 0, symmetric=True),
        )  # fmt: skip

    def executor(self) -> Executor:
        """Where episodes are walked."""
        motors, robot = self.motors, self.robot
        scene = Scene(robot, "mujoco", motors.drawer(robot), motors.physics_dt(robot), self.walk)
        return make_executor(scene.simulator, self.settings.workers)


def run_policy(simulator: Any, _: None, task: tuple[PolicyArrays, int]) -> EpisodeLike:
    """One episode of a policy, on the motors of a seed."""
    policy, seed = task
    return simulator.run(policy, seed)


def challenge(executor: Executor, seed: int, policy: PolicyArrays, iteration: int, champion: Champion) -> Champion:
    """The better of two policies on the draws of the contests of a seed's search, as in `motorprior walk`."""
    seeds = [episode_seed(seed, CONTEST, draw) for draw in range(CONTEST_DRAWS)]
    score = float(np.mean([each.total for each in executor.map(run_policy, None, [(policy, one) for one in seeds])]))
    return Champion(policy, score, iteration) if score > champion.score else champion


def the_gait(walker: Walker, seed: int, executor: Executor) -> Champion:
    """The policy of zero weights: what nothing improves on is kept."""
    nobody = Champion.none_yet(walker.shape)
    return challenge(executor, seed, nobody.policy, 0, nobody)


def searched(walker: Walker, search: Search, seed: int, executor: Executor) -> Champion:
    """The best policy of a search; observations are normalised as in ARS V2."""
    shape, iterations = walker.shape, walker.settings.iterations
    seen, average = Moments.empty(shape.observations), search.center
    champion = the_gait(walker, seed, executor)
    for iteration in range(iterations):
        candidates = search.ask()
        numbers = np.arange(len(candidates)) // 2 if search.pairs else np.zeros(len(candidates), dtype=int)
        tasks = [
            (shape.policy(each, seen), episode_seed(seed, iteration, int(number)))
            for each, number in zip(candidates, numbers, strict=True)
        ]
        episodes = executor.map(run_policy, None, tasks)
        search.tell(np.array([episode.total for episode in episodes]))
        for episode in episodes:
            seen = seen.merge(Moments(episode.count, episode.mean, episode.m2))
        average = average + AVERAGING * (search.center - average)
        if (iteration + 1) % CONTEST_EVERY == 0 or iteration + 1 == iterations:
            champion = challenge(executor, seed, shape.policy(average, seen), iteration + 1, champion)
    return champion


def learned_by_ppo(walker: Walker, seed: int, executor: Executor) -> Champion:
    """The best policy of PPO."""
    motors = walker.motors.drawer(walker.robot)
    ppo = Ppo(walker.robot, motors, seed, commands=walker.walk.commands, episode_steps=EPISODE_STEPS)
    champion, iterations = the_gait(walker, seed, executor), walker.settings.iterations
    for iteration in range(CONTEST_EVERY, iterations + CONTEST_EVERY, CONTEST_EVERY):
        done = min(iteration, iterations)
        ppo.learn_until(done * POPULATION * EPISODE_STEPS)
        champion = challenge(executor, seed, ppo.policy(), done, champion)
    return champion


def train(walker: Walker, condition: Condition, seed: int) -> Path:
    """The folder of a method's policy of a seed, trained unless it is there."""
    settings, method, motors = walker.settings, condition.name, walker.motors
    folder = settings.out / "walk" / condition.folder(seed)
    if method in ARS:
        run_walk(
            Walk(
                folder, motors, iterations=settings.iterations, episode_steps=EPISODE_STEPS,
                commands=walker.walk.commands, randomization=Randomization(),
                search=ArsConfig(seed=seed, **ARS[method]), workers=settings.workers,
            ),
            PROGRESS, f"{method} {seed}",
        )  # fmt: skip
        return folder
    inputs = [*motors.inputs(walker.robot), *walker.robot.files]
    wanted = description("walk", {"method": method, "seed": seed, "iterations": settings.iterations}, inputs)
    if is_finished(folder, wanted):
        return folder
    PROGRESS.note(f"{method} {seed} ...")
    executor = walker.executor()
    remove(folder, UNFINISHED)  # none of these goes on: the seconds of an interrupted training do not count
    try:
        with working(folder, wanted):
            if method == PPO:
                champion = learned_by_ppo(walker, seed, executor)
            else:
                champion = searched(walker, SEARCHES[method](walker.shape.size, POPULATION, seed), seed, executor)
            provenance = {
                "motors": choice_as_json(motors, folder), "engine": "mujoco", "roughness": 0.0, "method": method,
                "commands": asdict(walker.walk.commands), "randomization": Randomization().as_json(),
            }  # fmt: skip
            nominal = motors.nominal(walker.robot)
            policy_of(walker.robot, "trot", champion, nominal, provenance).save(folder / POLICY)
    finally:
        executor.close()
    return folder


def measured(settings: Settings) -> tuple[WalkTable, Results]:
    """Every walk of every policy; of every training its seconds, and the return of what it kept."""
    walker, twins, walks, rows = Walker.of(settings), twins_here(PROGRESS), [], []
    robot = load_robot(settings.study.robot)
    for seed in range(settings.seeds):
        for method in settings.methods:
            condition = Condition(method, walker.motors)
            folder = train(walker, condition, seed)
            kept = float(Policy.load(folder / POLICY).provenance["own_return"])
            rows += [Result(f"{method}/seconds", "s", seconds_of(folder), seed=seed)]
            rows += [Result(f"{method}/return", "m", kept, seed=seed)]
            walks += watched(settings.study, robot, twins, condition, seed, PROGRESS).walks
    return WalkTable.of(walks), Results.of(rows)


def figures_of(table: WalkTable, trainings: Results) -> Results:
    """Medians over seeds of what trainings took and gave; measures by place, with intervals."""
    rows = list(trainings)
    for quantity in trainings.distinct("quantity"):
        of_it = trainings.where(quantity=quantity).rows
        rows.append(Result(quantity, of_it[0].unit, float(np.median([row.value for row in of_it])), statistic="median"))
    for method in table.distinct("condition"):
        for place in table.distinct("place"):
            for measure in MEASURES:
                found = estimate(table.scores(place, method, measure), statistic_of(measure))
                rows += with_interval(f"{method}/{place}/{measure}", UNITS[measure], found)
    return Results.of(rows)


def markdown(figures: dict[str, float], methods: tuple[str, ...], places: list[str]) -> str:
    """A row per method: time, return, then speed with its interval, time upright and way to the side at every place."""
    lines = [
        f"| search | seconds | return [m] | {' | '.join(places)} |",
        "|---|---|---|" + "---|" * len(places),
    ]
    for method in methods:
        cells = [f"{figures[f'{method}/seconds']:.0f}", f"{figures[f'{method}/return']:.2f}"]
        for place in places:
            speed, low, high, upright, drift = (
                figures.get(f"{method}/{place}/{name}", float("nan"))
                for name in ("speed", "speed/low", "speed/high", "upright", "drift")
            )
            cells.append(f"{speed:.2f} m/s [{low:.2f}, {high:.2f}], {upright:.0%}, {drift:.2f} m")
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, write, print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    for method in settings.methods:
        if method not in METHODS:
            sys.exit(f"no method {method!r}: use some of {', '.join(METHODS)}")
    for name in ("seeds", "iterations", "draws", "workers"):
        require_count(name, getattr(settings, name))
    with locked(settings.out):
        table, trainings = measured(settings)
        table.save(settings.out / "walks.csv")
        results = figures_of(table, trainings)
        write_json(settings.out / "figures.json", results.to_figures())
        text = markdown(results.to_figures(), settings.methods, table.distinct("place"))
        write_text(settings.out / "tables.md", text)
    print(text)


if __name__ == "__main__":
    main()
