"""The transfer study: policies trained on each model of a bench's motors, evaluated on held-out robots.

1. Record benches of motors; fit the models to them.
2. Select the range of the randomised PD and the share of the adapted prior on a fleet that no test environment uses.
3. Adapt the prior and a PD to ten seconds of log of each robot.
4. Train a policy per bench, condition and seed; evaluate it in its training simulation and in four environments.
5. Summarise: interquartile mean speed and mean time upright with 95 % intervals over benches; differences from the
   sampled prior with permutation p-values, corrected by Holm.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_json, write_text
from motorprior.bench.fleet import fleet_files, load_robot_fleet
from motorprior.commands import study_conditions as conditions
from motorprior.commands.study_conditions import Condition
from motorprior.commands.study_settings import VALIDATION, Study
from motorprior.commands.walk import POLICY, SEEDS_APART, Walk, run_walk
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.control_step import TaskWeights
from motorprior.locomotion.executor import make_executor, ray_cluster
from motorprior.progress import SILENT, Progress, Task, in_parallel, usable_threads
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.scene import WalkConfig
from motorprior.stage import PAGE, description, is_finished, locked, working, write_results
from motorprior.studies import summary
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY, motors_of_walk, twin_scene, walk_seed
from motorprior.studies.gait_quality import walk_measures
from motorprior.studies.summary import ADAPTED, StudyStatistics, WalkRow, read_walks, summarise, write_walks

WALKS = "walks.csv"
CHOICES = {"pd_range": (0.1, 0.2, 0.3, 0.4), "prior_share": (0.0, 0.25, 0.5, 1.0)}
_AS_GOOD = 0.01  # times upright that differ by less count as equal, so that the faster setting is selected [-]
SELECTION_SEEDS = range(900, 902)  # of policies and robots, used by no condition
_EPISODE_STEPS = 500  # of training
# of the search: with the defaults, 0.02 and 0.03, policies of the same budget fall more often on held-out robots
_STEP_SIZE, _DELTA_STD = 0.03, 0.04


def run_study(config: Study, progress: Progress = SILENT, command: str = "") -> StudyStatistics:
    """Run every stage that is not finished; write walks.csv, results.json, figures.json and report.html."""
    config.require_valid()
    with locked(config.out):
        found = summarise(study_walks(config, progress))
        write_results(config.out, found.as_results())
        _write_page(config, found, command)
    return found


def study_walks(config: Study, progress: Progress) -> list[WalkRow]:
    """The walks of a study, also in WALKS: of policies that are trained and evaluated unless they are finished."""
    threads = usable_threads(config.workers, progress)
    config = config if config.ray_address else replace(config, workers=threads)
    conditions.fit_models(config.of_benches(), threads, progress)
    config = with_selected(config, threads, progress)
    benches = config.of_benches()
    conditions.adapt_robots([robot for bench in benches for robot in conditions.robots_of(bench)], threads, progress)
    of_seeds = ((bench, seed) for seed in range(config.seeds) for bench in benches)
    policies = [each for bench, seed in of_seeds for each in conditions.conditions_of(bench, seed)]
    policies.sort(key=lambda each: each.name != "oracle")  # the longest first, otherwise they run alone at the end
    walks = walk_table(config, policies, progress)
    write_walks(config.out / WALKS, walks)
    return walks


def with_selected(config: Study, threads: int, progress: Progress) -> Study:
    """The study with the settings whose policies are upright for longest on robots of the validation fleet, and fast.

    They are selected once for all benches, with the models of the first.
    """
    first, fleet = config.of_benches()[0], config.validation_fleet(load_robot(config.robot))
    bench = replace(first, out=config.out / "selection", foreign=str(fleet), validation=fleet)
    chosen = {}
    for setting, name in config.to_select().items():
        if name in ADAPTED:
            robots = [(first, VALIDATION, seed) for seed in SELECTION_SEEDS]
            conditions.adapt_robots(robots, threads, progress)
        found = {}
        for value in CHOICES[setting]:
            policies = []
            for seed in SELECTION_SEEDS:
                motors = conditions.condition_motors(replace(first, **{setting: value}), name, VALIDATION, seed)
                robot, shown = seed if name in ADAPTED else None, f"{name}_{value:g}"
                policies.append(
                    Condition(bench, shown, seed, motors, environments=(OUT_OF_FAMILY, "hard"), robot=robot)
                )
            walks = [walk for walk in walk_table(config, policies, progress) if walk["place"] in ENVIRONMENTS]
            found[value] = [float(np.mean([walk[measure] for walk in walks])) for measure in ("upright", "speed")]
        max_needed = max(upright for upright, _ in found.values()) - _AS_GOOD
        chosen[setting] = max(found, key=lambda value: (min(found[value][0], max_needed), found[value][1]))
        write_json(bench.out / f"{setting}.json", {"fleet": fleet, "upright, speed": found, "chosen": chosen[setting]})
        progress.note(f"{setting}, selected on the fleet {fleet!r}: {chosen[setting]:g}")
    return replace(config, **chosen)


def walk_table(config: Study, policies: Sequence[Condition], progress: Progress = SILENT) -> list[WalkRow]:
    """Train and evaluate policies; finished ones are read."""
    environments = tuple(ENVIRONMENTS)
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"note: skipped the environment pybullet: {error}")
        environments = tuple(name for name, each in ENVIRONMENTS.items() if each.engine != "pybullet")
    at_a_time = usable_threads(config.workers, SILENT) if config.executor == "threads" else 1
    processes = config.workers if config.ray_address is not None else usable_threads(config.workers, SILENT)
    name = f"study: {len(policies)} policies, {config.draws} walks per environment"
    cluster = ray_cluster(processes, config.ray_address) if config.executor == "ray" else nullcontext()
    with progress.start(name, len(policies)) as task, cluster:
        works = [partial(_walks_of, environments, policy, task) for policy in policies]
        return [walk for walks in in_parallel(works, at_a_time, progress) for walk in walks]


def _walks_of(environments: tuple[str, ...], condition: Condition, task: Task, progress: Progress) -> list[WalkRow]:
    """Train and evaluate one policy."""
    bench, robot = condition.bench, load_robot(condition.bench.robot)
    policy, folder = _train(robot, condition, progress), bench.out / "watched" / condition.folder
    tested = tuple(each for each in condition.environments if each in environments)
    settings = {
        "twins": tested, "draws": bench.draws, "seconds": bench.seconds, "speed": bench.commanded,
        "study": bench.seed, "condition": condition.name, "robot": condition.robot,
    }  # fmt: skip
    fleets = [file for fleet in (bench.fleet, bench.foreign) for file in fleet_files(robot, fleet)]
    wanted = description("study", settings, [policy, *fleets, *robot.files])
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            write_walks(folder / WALKS, _evaluate(TrainedPolicy.load(policy, robot), condition, tested))
    walks = read_walks(folder / WALKS)
    if diverged := sum(np.isnan(walk["upright"]) for walk in walks):
        name = f"bench {bench.seed}, {condition.folder}"
        progress.note(f"warning: {diverged} of {len(walks)} walks of {name} diverged: excluded from all figures")
    task.advance(1, f"bench {bench.seed}, {condition.folder}")
    return walks


def _train(robot: Robot, condition: Condition, progress: Progress) -> Path:
    """The policy's file."""
    bench, name = condition.bench, condition.folder
    # a robot that stands earns a little; with the default, weak robots earn less by stumbling on than by falling early,
    # and their search ends there
    task = TaskWeights(alive=TaskWeights().speed * bench.commanded + 0.5)
    seed, top = SEEDS_APART * bench.seed + condition.seed, max(1, bench.directions // 2)
    search = ArsConfig(bench.directions, top, _STEP_SIZE, _DELTA_STD, seed)
    walk = Walk(
        out=bench.out / "walk" / name, motors=condition.motors, randomization=condition.randomization,
        commands=bench.commands, task=task, episode_steps=_EPISODE_STEPS, iterations=bench.iterations,
        search=search, validation=bench.validation_fleet(robot), robot=bench.robot,
        workers=bench.episodes_at_a_time, executor=bench.executor, ray_address=bench.ray_address,
    )  # fmt: skip
    run_walk(walk, progress, f"bench {bench.seed}, {name}")
    return walk.out / POLICY


def _evaluate(trained: TrainedPolicy, condition: Condition, environments: tuple[str, ...]) -> list[WalkRow]:
    """Walks of a policy in its training simulation and in environments."""
    bench, robot, policy, draws = condition.bench, trained.robot, trained.policy.arrays, range(condition.bench.draws)
    steps, seed_of = round(bench.seconds / robot.control_dt), partial(walk_seed, bench.seed)
    walk = WalkConfig(steps, commands=bench.commands, gait=trained.policy.gait)
    executor = partial(make_executor, workers=bench.episodes_at_a_time, kind=bench.executor, address=bench.ray_address)
    own = summary.OWN_FOREIGN if condition.population == OUT_OF_FAMILY else summary.OWN
    scene = trained.scene(replace(walk, randomization=condition.randomization))
    episodes = {own: run_walks(scene, policy, draws, seed_of, executor=executor)}
    for name in environments:
        environment = ENVIRONMENTS[name]
        fleet = load_robot_fleet(robot, bench.fleet_of(environment.population))
        motors = partial(motors_of_walk, robot, fleet, bench.seed, condition.robot)
        scene = twin_scene(robot, fleet, replace(walk, randomization=environment.randomization), environment.engine)
        episodes[name] = run_walks(scene, policy, draws, seed_of, motors, executor)
    return [
        {"bench": bench.seed, "place": place, "condition": condition.name, "seed": condition.seed, "draw": draw}
        | walk_measures(robot, episode, bench.commanded, steps)
        for place, walked in episodes.items()
        for draw, episode in enumerate(walked)
    ]


def _write_page(config: Study, found: StudyStatistics, command: str) -> None:
    from motorprior.report.page import page  # here: they import matplotlib
    from motorprior.report.study import study_sections

    robot = load_robot(config.robot)
    settings = asdict(config) | {"speed": config.commanded, "validation": config.validation_fleet(robot)}
    for name in ("out", "workers", "executor", "ray_address"):  # the result does not depend on them
        del settings[name]
    write_text(config.out / PAGE, page("Transfer study", study_sections(found), settings, command))
