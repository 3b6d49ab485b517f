"""The transfer study: policies trained on each model of a bench's motors, on held-out robots.

1. Record benches of motors; fit the models to them (`transfer_models`).
2. Select the range of the randomised PD and the share of the adapted prior on a fleet that no test
   environment uses.
3. Adapt the prior and a PD to ten seconds of log of each robot (`transfer_models`).
4. Train a policy per bench, training condition and seed; evaluate it in its training simulation and
   in five environments.

`statistics` summarises the walks, and `report.transfer_page` shows them.
"""

import re
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from motorprior.actuator.fleet import fleet_files, load_robot_fleet
from motorprior.artifacts import write_json
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.control_step import TaskWeights
from motorprior.locomotion.executor import make_executor, ray_cluster
from motorprior.progress import SILENT, Progress, Task, in_parallel, usable_threads
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import Episode, WalkConfig
from motorprior.simulation.training import POLICY, WalkSettings, train_policy
from motorprior.stage import description, is_finished, working
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import (
    ENVIRONMENTS,
    IN_FAMILY,
    OUT_OF_FAMILY,
    held_out_scene,
    motors_of_walk,
    walk_seed,
)
from motorprior.studies.gait_quality import walk_metrics
from motorprior.studies.statistics import (
    IN_TRAINING,
    IN_TRAINING_OUT_OF_FAMILY,
    WalkRow,
    read_walks,
    write_walks,
)
from motorprior.studies.study_settings import (
    CONDITIONS,
    SHORT_ITERATIONS,
    TRAINING,
    VALIDATION,
    Study,
    condition_of,
)
from motorprior.studies.transfer_models import (
    adapt_robots,
    fit_models,
    motors_of_condition,
    robots_of,
)

WALKS = "walks.csv"
SELECTION = "selection"  # folder of the policies that select settings, and of the selected settings

CHOICES = {"pd_range": (0.1, 0.2, 0.3, 0.4), "prior_share": (0.0, 0.25, 0.5, 1.0)}
# Difference of times upright below which two values of a setting count as equal [-]; the value with
# the faster policies is then selected.
_EQUAL_UPRIGHT = 0.01
SELECTION_SEEDS = range(900, 902)  # seeds of policies and robots, used by no training condition

SEEDS_APART = 1000  # distance between search seeds of two benches: benches share no search seed
_EPISODE_STEPS = 500  # episode length in training [control steps]
# with the search's default of 0.03, policies of the same budget fall more often on held-out robots
_DELTA_STD = 0.04


class StudyWalks(NamedTuple):
    """The walks of a study, and its settings with the selected ones."""

    walks: list[WalkRow]
    study: Study


def study_walks(config: Study, progress: Progress = SILENT) -> StudyWalks:
    """Train and evaluate the policies of a study, and write their walks to the table WALKS.

    Finished stages are not repeated.
    """
    threads = usable_threads(config.workers, progress)
    if not config.ray_address:
        config = replace(config, workers=threads)

    fit_models(config.of_benches(), threads, progress)
    config = with_selected(config, threads, progress)
    benches = config.of_benches()
    robots = [robot for bench in benches for robot in robots_of(bench)]
    adapt_robots(robots, threads, progress)

    runs = []
    for seed in range(config.seeds):
        for bench in benches:
            runs.extend(policy_runs_of(bench, seed))
    # the oracle takes the longest, so it comes first: otherwise it would run alone at the end
    oracle_runs = [run for run in runs if run.name == "oracle"]
    other_runs = [run for run in runs if run.name != "oracle"]
    runs = oracle_runs + other_runs

    walks = walk_table(config, runs, progress)
    write_walks(config.out / WALKS, walks)
    return StudyWalks(walks, config)


def with_selected(config: Study, threads: int, progress: Progress) -> Study:
    """The study with the selected values of the settings `Study.to_select`.

    A value is selected if its policies are upright for the longest time on robots of the validation
    fleet; among nearly equal times, if its policies are the fastest. The values are selected once
    for all benches, with the models of the first bench.
    """
    fleet = config.validation_fleet(load_robot(config.robot))
    selected = {}
    for setting, condition_name in config.to_select().items():
        if CONDITIONS[condition_name].adapted:
            first_bench = config.of_benches()[0]
            robots = [(first_bench, VALIDATION, seed) for seed in SELECTION_SEEDS]
            adapt_robots(robots, threads, progress)

        upright_and_speed = {}
        for value in CHOICES[setting]:
            runs = _selection_runs(config, setting, value, condition_name)
            upright_and_speed[value] = _mean_upright_and_speed(config, runs, progress)

        value = _best_choice(upright_and_speed)
        selected[setting] = value
        record = {"fleet": fleet, "upright, speed": upright_and_speed, "chosen": value}
        write_json(config.out / SELECTION / f"{setting}.json", record)
        progress.note(f"{setting}, selected on the fleet {fleet!r}: {value:g}")
    return replace(config, **selected)


def _selection_runs(
    config: Study, setting: str, value: float, condition_name: str
) -> list["PolicyRun"]:
    """The policies with one value of a setting, evaluated on the validation fleet."""
    fleet = config.validation_fleet(load_robot(config.robot))
    first_bench = config.of_benches()[0]
    # the environments of the out-of-family motors evaluate the policies on the validation fleet
    bench = replace(
        first_bench, out=config.out / SELECTION, out_of_family=str(fleet), validation=fleet
    )
    with_value = replace(first_bench, **{setting: value})

    runs = []
    for seed in SELECTION_SEEDS:
        run = PolicyRun(
            bench,
            name=f"{condition_name}_{value:g}",
            seed=seed,
            motors=motors_of_condition(with_value, condition_name, VALIDATION, seed),
            environments=(OUT_OF_FAMILY, "hard_out_of_family"),
            robot_number=seed if CONDITIONS[condition_name].adapted else None,
        )
        runs.append(run)
    return runs


def _mean_upright_and_speed(
    config: Study, runs: Sequence["PolicyRun"], progress: Progress
) -> list[float]:
    """Mean time upright [-] and speed [m/s] of policies in their test environments."""
    walks = walk_table(config, runs, progress)
    tested = [walk for walk in walks if walk["environment"] in ENVIRONMENTS]
    return [
        float(np.mean([walk["upright"] for walk in tested])),
        float(np.mean([walk["speed"] for walk in tested])),
    ]


def _best_choice(upright_and_speed: dict[float, list[float]]) -> float:
    """The value with the longest time upright; among nearly equal times, with the highest speed."""
    max_upright = max(upright for upright, _ in upright_and_speed.values())
    equal_upright = max_upright - _EQUAL_UPRIGHT  # longer times count as equal to this one

    def rank(value: float) -> tuple[float, float]:
        upright, speed = upright_and_speed[value]
        return min(upright, equal_upright), speed

    return max(upright_and_speed, key=rank)


@dataclass(frozen=True)
class PolicyRun:
    """A policy to train and to evaluate."""

    bench: Study  # settings of its bench, see `Study.of_benches`
    name: str  # training condition in tables
    seed: int  # seed of the training
    motors: str  # motors of the training episodes, as a text for `walk --motors`
    # randomisation of the training episodes, in addition to the motors
    randomization: Randomization = TRAINING
    population: str = IN_FAMILY  # OUT_OF_FAMILY for conditions trained for out-of-family motors
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)  # environments of the evaluation
    # number of the only robot that it is evaluated on; None: walk k is on robot k
    robot_number: int | None = None

    @property
    def folder(self) -> str:
        """Name of the policy's folder."""
        population = "" if self.population == IN_FAMILY else f"_{self.population}"
        return re.sub(r"[^\w.=-]", "_", f"{self.name}{population}_{self.seed}")


def policy_runs_of(bench: Study, seed: int) -> list[PolicyRun]:
    """The policies of this seed on a bench."""
    runs = []
    for name in bench.conditions:
        if seed not in bench.seeds_of(name):
            continue
        condition = condition_of(name)
        if not condition.per_population:
            runs.append(_policy_run(bench, name, seed, IN_FAMILY, bench.environments))
            continue
        for population in (OUT_OF_FAMILY, IN_FAMILY):
            environments = []
            for environment in bench.environments:
                if ENVIRONMENTS[environment].population == population:
                    environments.append(environment)
            if environments:
                runs.append(_policy_run(bench, name, seed, population, tuple(environments)))
    return runs


def _policy_run(
    bench: Study, name: str, seed: int, population: str, environments: tuple[str, ...]
) -> PolicyRun:
    condition = condition_of(name)
    iterations = bench.iterations
    if condition.iterations is not None:
        iterations = min(condition.iterations, iterations)
    if name in bench.short:
        iterations = min(SHORT_ITERATIONS, iterations)
    number = bench.robot_number(seed)
    return PolicyRun(
        replace(bench, iterations=iterations),
        name=name,
        seed=seed,
        motors=motors_of_condition(bench, name, population, number),
        randomization=condition.randomization,
        population=population,
        environments=environments,
        robot_number=number if condition.adapted else None,
    )


def walk_table(
    config: Study, runs: Sequence[PolicyRun], progress: Progress = SILENT
) -> list[WalkRow]:
    """The walks of policies, which are trained and evaluated unless they are finished."""
    environments = _installed_environments(progress)
    threads = usable_threads(config.workers, SILENT)
    at_a_time = threads if config.executor == "threads" else 1

    cluster: AbstractContextManager[object] = nullcontext()
    if config.executor == "ray":
        processes = threads if config.ray_address is None else config.workers
        cluster = ray_cluster(processes, config.ray_address)

    title = f"study: {len(runs)} policies, {config.walks} walks per environment"
    with progress.start(title, len(runs)) as task, cluster:
        works = [partial(_walks_of, environments, run, task) for run in runs]
        walks_of_runs = in_parallel(works, at_a_time, progress)
    return [walk for walks in walks_of_runs for walk in walks]


def _installed_environments(progress: Progress) -> tuple[str, ...]:
    """The environments whose engine is installed."""
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"skipped the environment pybullet: {error}")
        return tuple(
            name for name, environment in ENVIRONMENTS.items() if environment.engine != "pybullet"
        )
    return tuple(ENVIRONMENTS)


def _walks_of(
    installed: tuple[str, ...], run: PolicyRun, task: Task, progress: Progress
) -> list[WalkRow]:
    """The walks of a policy; it is trained and evaluated unless it is finished."""
    bench = run.bench
    robot = load_robot(bench.robot)
    policy = _train(robot, run, progress)
    environments = tuple(name for name in run.environments if name in installed)

    folder = bench.out / "walks" / run.folder
    settings = {
        "environments": environments,
        "walks": bench.walks,
        "seconds": bench.seconds,
        "speed": bench.commanded,
        "study": bench.seed,
        "condition": run.name,
        "robot": run.robot_number,
    }
    files = [
        policy,
        *fleet_files(robot, bench.fleet),
        *fleet_files(robot, bench.out_of_family),
        *robot.files,
    ]
    stage_description = description("study", settings, files)
    if not is_finished(folder, stage_description):
        with working(folder, stage_description):
            walks = _evaluate(TrainedPolicy.load(policy, robot), run, environments)
            write_walks(folder / WALKS, walks)

    walks = read_walks(folder / WALKS)
    title = f"bench {bench.seed}, {run.folder}"
    diverged = sum(np.isnan(walk["upright"]) for walk in walks)
    if diverged:
        progress.warn(
            f"{diverged} of {len(walks)} walks of {title} diverged: excluded from all figures"
        )
    task.advance(1, title)
    return walks


def training_settings(
    bench: Study, seed: int, randomization: Randomization = TRAINING
) -> WalkSettings:
    """Settings of the training of a policy with this seed on a bench."""
    # A robot that stands still at a commanded speed has a small positive reward. With the
    # default, a robot that walks badly has a negative reward; one that falls at once has almost
    # none, so the search would learn to fall.
    alive = TaskWeights().speed * bench.commanded + 0.5
    search = ArsConfig(
        bench.directions,
        bench.directions,
        ArsConfig.step_size,
        _DELTA_STD,
        SEEDS_APART * bench.seed + seed,
    )
    return WalkSettings(
        randomization=randomization,
        commands=bench.commands,
        task=TaskWeights(alive=alive),
        episode_steps=_EPISODE_STEPS,
        iterations=bench.iterations,
        patience=bench.patience,
        search=search,
        validation=bench.validation_fleet(load_robot(bench.robot)),
    )


def _train(robot: Robot, run: PolicyRun, progress: Progress) -> Path:
    """Train a policy unless it is finished; returns its file."""
    bench = run.bench
    out = bench.out / "policies" / run.folder
    train_policy(
        robot,
        run.motors,
        training_settings(bench, run.seed, run.randomization),
        out=out,
        workers=bench.episodes_at_a_time,
        executor=bench.executor,
        ray_address=bench.ray_address,
        name=f"bench {bench.seed}, {run.folder}",
        progress=progress,
    )
    return out / POLICY


def _evaluate(
    trained: TrainedPolicy, run: PolicyRun, environments: tuple[str, ...]
) -> list[WalkRow]:
    """Walks of a policy in its training simulation and in these environments."""
    bench = run.bench
    robot = trained.robot
    policy = trained.policy.arrays
    numbers = range(bench.walks)
    steps = round(bench.seconds / robot.control_dt)
    seed_of_walk = partial(walk_seed, bench.seed)
    walk = WalkConfig(steps, commands=bench.commands)
    executor = partial(
        make_executor,
        workers=bench.episodes_at_a_time,
        name=bench.executor,
        address=bench.ray_address,
    )
    episodes: dict[str, list[Episode]] = {}

    # the training simulation
    training_name = IN_TRAINING_OUT_OF_FAMILY if run.population == OUT_OF_FAMILY else IN_TRAINING
    scene = trained.scene(replace(walk, randomization=run.randomization))
    episodes[training_name] = run_walks(scene, policy, numbers, seed_of_walk, executor=executor)

    # held-out robots
    for name in environments:
        environment = ENVIRONMENTS[name]
        fleet = load_robot_fleet(robot, bench.fleet_of(environment.population))
        motors = partial(motors_of_walk, robot, fleet, bench.seed, run.robot_number)
        walk_in_environment = replace(
            walk, randomization=environment.randomization, engine=environment.engine
        )
        scene = held_out_scene(robot, fleet, walk_in_environment)
        episodes[name] = run_walks(scene, policy, numbers, seed_of_walk, motors, executor)

    rows = []
    for name, walked in episodes.items():
        for number, episode in enumerate(walked):
            row: WalkRow = {
                "bench": bench.seed,
                "environment": name,
                "condition": run.name,
                "seed": run.seed,
                "walk": number,
            }
            rows.append(row | walk_metrics(robot, episode, bench.commanded, steps))
    return rows
