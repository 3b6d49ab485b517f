"""The transfer study: policies trained on each model of a bench's motors, evaluated on held-out robots.

1. Record a bench of motors; fit the models to it. Adapt the prior and a PD to ten seconds of log of each robot.
2. Select the range of the randomised PD on a fleet that no test environment uses.
3. Train a policy per condition and seed; evaluate it in its training simulation and in four environments.
4. Summarise: interquartile mean speed and mean time upright with 95 % intervals; differences from the sampled prior
   with permutation p-values, corrected by Holm.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from motorprior.actuator.actuator import Actuator
from motorprior.artifacts import write_json, write_text
from motorprior.bench.fleet import Fleet, fleet_files, load_robot_fleet
from motorprior.commands import study_conditions as conditions
from motorprior.commands.study_conditions import Condition, Study
from motorprior.commands.walk import POLICY, SEEDS_APART, Walk, run_walk
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import make_executor, ray_cluster
from motorprior.locomotion.policy import Policy, zero_policy
from motorprior.progress import SILENT, Progress, Task, in_parallel, usable_threads
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.scene import Episode, WalkConfig
from motorprior.stage import PAGE, description, is_finished, locked, working, write_results
from motorprior.studies import summary
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY, motors_of_robot, twin_scene, walk_seed
from motorprior.studies.gait_quality import walk_measures
from motorprior.studies.summary import ADAPTED, Summary, WalkRow, read_walks, summarise, write_walks

WALKS, SPREADS = "walks.csv", "spreads.json"
PD_RANGES = (0.1, 0.2, 0.3, 0.4)  # of the randomised PD, to select from
PD_RANGE_SEEDS = range(900, 903)  # used by no condition
_EPISODE_STEPS = 500  # of training


def run_study(config: Study, progress: Progress = SILENT, command: str = "") -> Summary:
    """Run every stage that is not finished; write walks.csv, results.json, figures.json and report.html.

    Raises:
        MotorPriorError: invalid settings, or a failed stage; finished stages stay.
    """
    config.require_valid()
    with locked(config.out):
        threads = usable_threads(config.workers, progress)
        config = config if config.ray_address else replace(config, workers=threads)
        conditions.fit_models(config, threads, progress)
        config = with_pd_range(config, progress)
        conditions.adapt_robots(config, threads, progress)
        policies = [each for seed in range(config.seeds) for each in conditions.conditions_of(config, seed)]
        walks = walk_table(config, policies, progress)
        write_walks(config.out / WALKS, walks)
        found = summarise(walks)
        write_results(config.out, found.as_results())
        _write_page(config, found, command)
    return found


def with_pd_range(config: Study, progress: Progress) -> Study:
    """The study with the range of its randomised PD whose policies are upright for longest on the validation fleet."""
    if config.spread is not None or "pd_randomised" not in config.conditions:
        return config
    robot = load_robot(config.robot)
    fleet = config.validation_fleet(robot)
    names = {spread: f"pd_randomised_{spread:g}" for spread in PD_RANGES}
    tried = [
        Condition(name, seed, conditions.randomized_pd(config, spread), environments=(OUT_OF_FAMILY,))
        for seed in PD_RANGE_SEEDS[: config.seeds]
        for spread, name in names.items()
    ]
    search = replace(config, out=config.out / "spreads", foreign=str(fleet), validation=fleet)
    walks, found = walk_table(search, tried, progress), {}
    for spread, name in names.items():
        own = [walk for walk in walks if (walk["place"], walk["condition"]) == (OUT_OF_FAMILY, name)]
        found[spread] = {measure: summary.estimate(own, measure).value for measure in summary.COMPARED}
    best = max(found, key=lambda spread: (found[spread]["upright"], found[spread]["speed"]))
    write_json(search.out / SPREADS, {"fleet": fleet, "tried": found, "chosen": best})
    progress.note(f"range of the randomised PD, selected on the fleet {fleet!r}: {best:g}")
    return replace(config, spread=best)


def walk_table(config: Study, policies: Sequence[Condition], progress: Progress = SILENT) -> list[WalkRow]:
    """Train and evaluate policies; finished ones in ``config.out`` are read."""
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
        works = [partial(_walks_of, config, environments, policy, task) for policy in policies]
        return [walk for walks in in_parallel(works, at_a_time, progress) for walk in walks]


def _walks_of(
    config: Study, environments: tuple[str, ...], condition: Condition, task: Task, progress: Progress
) -> list[WalkRow]:
    """Train and evaluate one policy."""
    robot, folder = load_robot(config.robot), config.out / "watched" / condition.folder
    policy, only = _train(config, robot, condition, progress), condition.seed if condition.name in ADAPTED else None
    tested = tuple(each for each in condition.environments if each in environments)
    settings = {
        "twins": tested, "draws": config.draws, "seconds": config.seconds, "speed": config.commanded(robot),
        "study": config.seed, "condition": condition.name, "robot": only,
    }  # fmt: skip
    fleets = [file for fleet in (config.fleet, config.foreign) for file in fleet_files(robot, fleet)]
    wanted = description("study", settings, [policy, *fleets, *robot.files])
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            write_walks(folder / WALKS, _evaluate(config, TrainedPolicy.load(policy, robot), condition, tested, only))
    task.advance(1, condition.folder)
    return read_walks(folder / WALKS)


def _train(config: Study, robot: Robot, condition: Condition, progress: Progress) -> Path:
    """The policy's file."""
    name, commands = condition.folder, config.commands(robot)
    walk = Walk(
        out=config.out / "walk" / name, motors=condition.motors, iterations=config.iterations, commands=commands,
        episode_steps=_EPISODE_STEPS, validation=config.validation_fleet(robot),
        randomization=condition.randomization, search=ArsConfig(seed=SEEDS_APART * config.seed + condition.seed),
        robot=config.robot, workers=config.episodes_at_a_time, executor=config.executor,
        ray_address=config.ray_address,
    )  # fmt: skip
    if condition.name == "untrained":
        robot = commands.extend_range(robot)
        nominal = simulated_motors(condition.motors, robot).nominal
        zero = Policy.of(robot, zero_policy(robot.num_joints), nominal.kp, nominal.kd)
        zero.save(walk.out / POLICY)
    else:
        run_walk(walk, progress, name)
    return walk.out / POLICY


def _evaluate(
    config: Study, trained: TrainedPolicy, condition: Condition, environments: tuple[str, ...], only: int | None
) -> list[WalkRow]:
    """Walks of a policy in its training simulation and in environments, there on the robot ``only`` if given."""
    robot, policy, draws = trained.robot, trained.policy.arrays, range(config.draws)
    steps, seed_of = round(config.seconds / robot.control_dt), partial(walk_seed, config.seed)
    walk = WalkConfig(steps, commands=config.commands(robot), gait=trained.policy.gait)
    executor = partial(
        make_executor, workers=config.episodes_at_a_time, kind=config.executor, address=config.ray_address
    )
    episodes: dict[str, list[Episode]] = {}
    if condition.name != "untrained":
        scene = trained.scene(replace(walk, randomization=condition.randomization))
        own = summary.OWN_FOREIGN if condition.population == OUT_OF_FAMILY else summary.OWN
        draws_own = draws[:1] if condition.name in conditions.FIXED_MOTORS else draws
        episodes[own] = run_walks(scene, policy, draws_own, seed_of, executor=executor)
    for name in environments:
        environment = ENVIRONMENTS[name]
        fleet = load_robot_fleet(robot, config.fleet_of(environment.population))
        motors = partial(_motors_of_draw, robot, fleet, config.seed, only)
        scene = twin_scene(robot, fleet, replace(walk, randomization=environment.randomization), environment.engine)
        episodes[name] = run_walks(scene, policy, draws, seed_of, motors, executor)
    return [
        {"place": place, "condition": condition.name, "seed": condition.seed, "draw": draw}
        | walk_measures(robot, episode, config.commanded(robot), steps)
        for place, walked in episodes.items()
        for draw, episode in enumerate(walked)
    ]


def _motors_of_draw(robot: Robot, fleet: Fleet, study: int, only: int | None, draw: int) -> Actuator:
    """Motors of the robot of a walk: robot ``only``, or if it is None, robot ``draw``."""
    return motors_of_robot(robot, fleet, study, draw if only is None else only).actuator()


def _write_page(config: Study, found: Summary, command: str) -> None:
    from motorprior.report.page import page  # here: they import matplotlib
    from motorprior.report.study import study_sections

    robot = load_robot(config.robot)
    settings = asdict(config) | {"speed": config.commanded(robot), "validation": config.validation_fleet(robot)}
    for name in ("out", "workers", "executor", "ray_address"):  # the result does not depend on them
        del settings[name]
    write_text(config.out / PAGE, page("Transfer study", study_sections(found), settings, command))
