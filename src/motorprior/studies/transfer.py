"""The transfer study: policies trained on each model of a bench's motors, evaluated on held-out robots.

1. Record benches of motors; fit the models to them.
2. Select the range of the randomised PD and the share of the adapted prior on a fleet that no test
environment uses. 3. Adapt the prior and a PD to ten seconds of log of each robot.
4. Train a policy per bench, condition and seed; evaluate it in its training simulation and in four
environments.

`statistics` summarises the walks.
"""

import re
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.bench_folder import record_bench
from motorprior.bench.fleet import fleet_files, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import seed_of
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import GAINS, RESTARTS, fit_pd
from motorprior.identification.presets import network_steps
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.control_step import TaskWeights
from motorprior.locomotion.executor import make_executor, ray_cluster
from motorprior.logs.motor_log import MotorLog, log_digest
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.priors.adapt import adapt
from motorprior.priors.fit_prior import PRIOR, fit_prior
from motorprior.progress import SILENT, Progress, Task, in_parallel, usable_threads
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import WalkConfig
from motorprior.simulation.training import POLICY, WalkSettings, train_policy
from motorprior.stage import description, is_finished, working
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import (
    ENVIRONMENTS,
    IN_FAMILY,
    OUT_OF_FAMILY,
    motors_of_robot,
    motors_of_walk,
    twin_scene,
    walk_seed,
)
from motorprior.studies.gait_quality import walk_measures
from motorprior.studies.statistics import OWN, OWN_OUT_OF_FAMILY, WalkRow, read_walks, write_walks
from motorprior.studies.study_settings import (
    CONDITIONS,
    OTHER_MOTORS,
    PDS,
    TRAINING,
    VALIDATION,
    Study,
)

WALKS = "walks.csv"
FIT = "fit.json"
LOG = "log.parquet"
POSTERIOR = "posterior.safetensors"
SELECTION = "selection"  # folder of the policies that select settings, and of the selected settings
LOG_SECONDS = 10.0  # duration of a robot's log for adaptation [s]
LOG_STREAM = 0x20B2  # random stream of these logs

CHOICES = {"pd_range": (0.1, 0.2, 0.3, 0.4), "prior_share": (0.0, 0.25, 0.5, 1.0)}
_EQUAL_SETTING = 0.01  # of settings whose times upright differ by less, the faster is selected [-]
SELECTION_SEEDS = range(900, 902)  # seeds of policies and robots, used by no condition

SEEDS_APART = 1000  # demos and studies with different seeds share no search seed
_EPISODE_STEPS = 500  # episode length in training [control steps]
# with the search's defaults, 0.02 and 0.03, policies of the same budget fall more often on held-out
# robots
_STEP_SIZE = 0.03
_DELTA_STD = 0.04


def study_walks(config: Study, progress: Progress = SILENT) -> list[WalkRow]:
    """The walks of a study, also in WALKS: of policies that are trained and evaluated unless they are finished."""
    threads = usable_threads(config.workers, progress)
    config = config if config.ray_address else replace(config, workers=threads)
    fit_models(config.of_benches(), threads, progress)
    config = with_selected(config, threads, progress)
    benches = config.of_benches()
    adapt_robots([robot for bench in benches for robot in robots_of(bench)], threads, progress)
    of_seeds = ((bench, seed) for seed in range(config.seeds) for bench in benches)
    policies = [each for bench, seed in of_seeds for each in policy_runs_of(bench, seed)]
    # the longest first, otherwise they run alone at the end
    policies.sort(key=lambda each: each.name != "oracle")
    walks = walk_table(config, policies, progress)
    write_walks(config.out / WALKS, walks)
    return walks


def record_benches(bench: Study, progress: Progress) -> dict[str, MotorLog]:
    """Record the motors of a bench; excitation -> log, the paper's only if a condition needs it."""
    fitted = {each.prior or each.pd for each in bench.fitted}
    kinds = [
        *(["paper"] if "paper" in fitted else []),
        *(["rollout"] if fitted - {"paper"} else []),
    ]
    return {
        kind: record_bench(
            bench.robot,
            bench.fleet,
            motors=bench.motors,
            steps=bench.bench_steps,
            preset=kind,
            seed=bench.seed,
            out=bench.out / "bench" / kind,
            progress=progress,
        )
        for kind in kinds
    }


def fit_models(benches: Sequence[Study], threads: int, progress: Progress) -> None:
    """Record the motors of the benches; identify the priors and fit the PDs that the conditions need."""
    works = []
    for bench in benches:
        logs = record_benches(bench, progress)
        # the longest first
        for preset in sorted({each.prior for each in bench.fitted if each.prior}, reverse=True):
            log = logs["paper" if preset == "paper" else "rollout"]
            steps = network_steps(preset, bench.adam_steps)
            works.append(
                partial(
                    _fit_prior, log, preset, bench.seed, steps, prior_path(bench, preset).parent
                )
            )
        if kinds := {each.pd for each in bench.fitted if each.pd and not each.adapted}:
            works.append(partial(_fit_pds, bench, logs["rollout"], bench.out / "fits", kinds))
    in_parallel(works, threads, progress)


def _fit_prior(
    log: MotorLog, preset: str, seed: int, steps: int | None, out: Path, progress: Progress
) -> None:
    fit_prior(log, preset, seed, steps=steps, out=out, progress=progress)


def prior_path(bench: Study, preset: str) -> Path:
    """The prior of a preset."""
    return bench.out / "priors" / preset / PRIOR


def _fit_pds(
    bench: Study, log: MotorLog, folder: Path, kinds: set[str], progress: Progress
) -> None:
    """Fit these kinds of PD to a log with known loads; the FIT of each has constants and error."""
    robot = load_robot(bench.robot)
    nominal = nominal_pd(load_robot_fleet(robot, bench.fleet), 1)
    start = {name: float(getattr(nominal, name)[0]) for name in GAINS}
    for out in (folder / kind for kind in sorted(kinds)):
        wanted = description(
            "study", {"start": start, "kind": out.name, "log": log_digest(log)}, robot.files
        )
        if not is_finished(out, wanted):
            with working(out, wanted), progress.start(f"fit the PD {out.name}", RESTARTS) as task:
                write_json(out / FIT, asdict(fit_pd(log, PDS[out.name], start, task.advance)))


def with_selected(config: Study, threads: int, progress: Progress) -> Study:
    """The study with the settings whose policies are upright for longest on robots of the validation fleet, and fast.

    They are selected once for all benches, with the models of the first.
    """
    first = config.of_benches()[0]
    fleet = config.validation_fleet(load_robot(config.robot))
    bench = replace(first, out=config.out / SELECTION, out_of_family=str(fleet), validation=fleet)
    chosen = {}
    for setting, name in config.to_select().items():
        if CONDITIONS[name].adapted:
            robots = [(first, VALIDATION, seed) for seed in SELECTION_SEEDS]
            adapt_robots(robots, threads, progress)
        found = {}
        for value in CHOICES[setting]:
            policies = []
            for seed in SELECTION_SEEDS:
                motors = motors_text(replace(first, **{setting: value}), name, VALIDATION, seed)
                number = seed if CONDITIONS[name].adapted else None
                shown = f"{name}_{value:g}"
                tested = OUT_OF_FAMILY, "hard"
                policies.append(
                    PolicyRun(bench, shown, seed, motors, environments=tested, robot_number=number)
                )
            walks = [
                walk
                for walk in walk_table(config, policies, progress)
                if walk["environment"] in ENVIRONMENTS
            ]
            found[value] = [
                float(np.mean([walk[measure] for walk in walks]))
                for measure in ("upright", "speed")
            ]
        max_needed = max(upright for upright, _ in found.values()) - _EQUAL_SETTING
        chosen[setting] = max(
            found, key=lambda value: (min(found[value][0], max_needed), found[value][1])
        )
        write_json(
            bench.out / f"{setting}.json",
            {"fleet": fleet, "upright, speed": found, "chosen": chosen[setting]},
        )
        progress.note(f"{setting}, selected on the fleet {fleet!r}: {chosen[setting]:g}")
    return replace(config, **chosen)


def adapt_robots(
    robots: Iterable[tuple[Study, str, int]], threads: int, progress: Progress
) -> None:
    """Record LOG_SECONDS of the motors of robots (bench, population, number), and adapt to them."""
    in_parallel([partial(_adapt, *robot) for robot in robots], threads, progress)


def robots_of(bench: Study) -> list[tuple[Study, str, int]]:
    """The robots that policies of a bench are adapted to."""
    adapted = any(each.adapted for each in bench.fitted)
    numbers = sorted({bench.robot_of(seed) for seed in range(bench.seeds)}) if adapted else []
    return [
        (bench, population, number)
        for number in numbers
        for population in (IN_FAMILY, OUT_OF_FAMILY)
    ]


def _robot_folder(bench: Study, population: str, number: int) -> Path:
    return bench.out / "robots" / f"{population}_{number}"


def _adapt(bench: Study, population: str, number: int, progress: Progress) -> None:
    robot = load_robot(bench.robot)
    folder = _robot_folder(bench, population, number)
    fleet = load_robot_fleet(robot, bench.fleet_of(population))
    preset = bench_preset("adapt").for_robot(robot)
    priors = [prior_path(bench, "rollout")] if "adapted_prior" in bench.conditions else []
    settings = {"study": bench.seed, "robot": number, "seconds": LOG_SECONDS}
    wanted = description(
        "study", settings, [*priors, *fleet_files(robot, bench.fleet_of(population)), *robot.files]
    )
    if not is_finished(folder, wanted):
        name = f"bench {bench.seed}: adapt to robot {folder.name}"
        with working(folder, wanted), progress.start(name, 1):
            motors = motors_of_robot(robot, fleet, bench.seed, number)
            steps = round(LOG_SECONDS / preset.period)
            log_seed = seed_of(LOG_STREAM, bench.seed, number)
            write_log(folder / LOG, log := record(motors, preset, steps, log_seed, fleet))
            for path in priors:
                adapt(MotorPrior.load(path), log, allow_outliers=True, progress=SILENT).save(
                    folder / POSTERIOR
                )
    if "adapted_pd" in bench.conditions and population != VALIDATION:
        _fit_pds(
            bench,
            read_parquet(folder / LOG),
            folder / "fits",
            {CONDITIONS["adapted_pd"].pd},
            progress,
        )


@dataclass(frozen=True)
class PolicyRun:
    """A policy to train and to evaluate."""

    bench: Study  # settings of its bench, see `Study.of_benches`
    name: str  # training condition in tables
    seed: int  # of the training
    motors: str  # motors of the training episodes
    # randomisation of the training episodes, in addition to the motors
    randomization: Randomization = TRAINING
    population: str = IN_FAMILY  # OUT_OF_FAMILY for conditions trained for out-of-family motors
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)  # in which it is evaluated
    robot_number: int | None = None  # the only robot that it walks on; all if None

    @property
    def folder(self) -> str:
        """Name of the policy's folder."""
        population = "" if self.population == IN_FAMILY else f"_{self.population}"
        return re.sub(r"[^\w.=-]", "_", f"{self.name}{population}_{self.seed}")


def policy_runs_of(bench: Study, seed: int) -> list[PolicyRun]:
    """The policies of this seed on a bench."""
    made = []
    for name in (name for name in bench.conditions if seed in bench.seeds_of(name)):
        condition = CONDITIONS.get(name, OTHER_MOTORS)
        number = bench.robot_of(seed)
        own = replace(
            bench, iterations=min(condition.iterations or bench.iterations, bench.iterations)
        )
        for population in (OUT_OF_FAMILY, IN_FAMILY) if condition.per_population else (IN_FAMILY,):
            within = (population,) if condition.per_population else (IN_FAMILY, OUT_OF_FAMILY)
            environments = tuple(
                each for each in bench.environments if ENVIRONMENTS[each].population in within
            )
            motors = motors_text(bench, name, population, number)
            only = number if condition.adapted else None
            made.append(
                PolicyRun(
                    own, name, seed, motors, condition.randomization, population, environments, only
                )
            )
    return made


def motors_text(bench: Study, name: str, population: str, number: int) -> str:
    """Motors of a condition: fitted to the bench or to the log of a robot, or those of a population."""
    if name not in CONDITIONS:
        return name
    condition = CONDITIONS[name]
    robot = _robot_folder(bench, population, number)
    if condition.pd:
        fit = read_json((robot if condition.adapted else bench.out) / "fits" / condition.pd / FIT)
        pd_range = bench.pd_range if name == "random_pd" else None
        return motor_text("pd", spread=pd_range, **fit["constants"])
    if not condition.prior:
        return motor_text("fleet", fleet=bench.fleet_of(population))
    prior = prior_path(bench, condition.prior)
    if condition.adapted:
        return motor_text(
            "posterior", file=robot / POSTERIOR, prior=prior, prior_share=bench.prior_share
        )
    return motor_text("prior", file=prior, **condition.options)


def walk_table(
    config: Study, policies: Sequence[PolicyRun], progress: Progress = SILENT
) -> list[WalkRow]:
    """Train and evaluate policies; finished ones are read."""
    environments = tuple(ENVIRONMENTS)
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"skipped the environment pybullet: {error}")
        environments = tuple(
            name for name, each in ENVIRONMENTS.items() if each.engine != "pybullet"
        )
    at_a_time = usable_threads(config.workers, SILENT) if config.executor == "threads" else 1
    processes = (
        config.workers if config.ray_address is not None else usable_threads(config.workers, SILENT)
    )
    name = f"study: {len(policies)} policies, {config.walks} walks per environment"
    cluster = (
        ray_cluster(processes, config.ray_address) if config.executor == "ray" else nullcontext()
    )
    with progress.start(name, len(policies)) as task, cluster:
        works = [partial(_walks_of, environments, policy, task) for policy in policies]
        return [walk for walks in in_parallel(works, at_a_time, progress) for walk in walks]


def _walks_of(
    environments: tuple[str, ...], run: PolicyRun, task: Task, progress: Progress
) -> list[WalkRow]:
    bench = run.bench
    robot = load_robot(run.bench.robot)
    policy = _train(robot, run, progress)
    folder = bench.out / "walks" / run.folder
    tested = tuple(each for each in run.environments if each in environments)
    settings = {
        "environments": tested,
        "walks": bench.walks,
        "seconds": bench.seconds,
        "speed": bench.commanded,
        "study": bench.seed,
        "condition": run.name,
        "robot": run.robot_number,
    }
    fleets = [
        file for fleet in (bench.fleet, bench.out_of_family) for file in fleet_files(robot, fleet)
    ]
    wanted = description("study", settings, [policy, *fleets, *robot.files])
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            write_walks(folder / WALKS, _evaluate(TrainedPolicy.load(policy, robot), run, tested))
    walks = read_walks(folder / WALKS)
    if diverged := sum(np.isnan(walk["upright"]) for walk in walks):
        name = f"bench {bench.seed}, {run.folder}"
        progress.warn(
            f"{diverged} of {len(walks)} walks of {name} diverged: excluded from all figures"
        )
    task.advance(1, f"bench {bench.seed}, {run.folder}")
    return walks


def _train(robot: Robot, run: PolicyRun, progress: Progress) -> Path:
    bench = run.bench
    name = run.folder
    # standing earns a little. With the default, walking badly earns less than falling, so the
    # search learns to fall
    task = TaskWeights(alive=TaskWeights().speed * bench.commanded + 0.5)
    seed = SEEDS_APART * bench.seed + run.seed
    top = max(1, bench.directions // 2)
    search = ArsConfig(bench.directions, top, _STEP_SIZE, _DELTA_STD, seed)
    settings = WalkSettings(
        randomization=run.randomization,
        commands=bench.commands,
        task=task,
        episode_steps=_EPISODE_STEPS,
        iterations=bench.iterations,
        patience=bench.patience,
        search=search,
        validation=bench.validation_fleet(robot),
    )
    out = bench.out / "policies" / name
    train_policy(
        robot,
        run.motors,
        settings,
        out=out,
        workers=bench.episodes_at_a_time,
        executor=bench.executor,
        ray_address=bench.ray_address,
        name=f"bench {bench.seed}, {name}",
        progress=progress,
    )
    return out / POLICY


def _evaluate(
    trained: TrainedPolicy, run: PolicyRun, environments: tuple[str, ...]
) -> list[WalkRow]:
    bench = run.bench
    robot = trained.robot
    policy = trained.policy.arrays
    numbers = range(run.bench.walks)
    steps = round(bench.seconds / robot.control_dt)
    seed_of = partial(walk_seed, bench.seed)
    walk = WalkConfig(steps, commands=bench.commands)
    executor = partial(
        make_executor,
        workers=bench.episodes_at_a_time,
        kind=bench.executor,
        address=bench.ray_address,
    )
    own = OWN_OUT_OF_FAMILY if run.population == OUT_OF_FAMILY else OWN
    scene = trained.scene(replace(walk, randomization=run.randomization))
    episodes = {own: run_walks(scene, policy, numbers, seed_of, executor=executor)}
    for name in environments:
        environment = ENVIRONMENTS[name]
        fleet = load_robot_fleet(robot, bench.fleet_of(environment.population))
        motors = partial(motors_of_walk, robot, fleet, bench.seed, run.robot_number)
        own_walk = replace(walk, randomization=environment.randomization, engine=environment.engine)
        scene = twin_scene(robot, fleet, own_walk)
        episodes[name] = run_walks(scene, policy, numbers, seed_of, motors, executor)
    return [
        {
            "bench": bench.seed,
            "environment": environment,
            "condition": run.name,
            "seed": run.seed,
            "walk": number,
        }
        | walk_measures(robot, episode, bench.commanded, steps)
        for environment, walked in episodes.items()
        for number, episode in enumerate(walked)
    ]
