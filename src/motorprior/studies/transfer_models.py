"""Models of motors for the trainings of the transfer study: priors and PDs of benches and robots.

A study folder has, per bench,

    bench/SCHEDULE        logs of the bench's motors
    priors/PRESET         priors identified from these logs
    fits/PD               PDs fitted to these logs
    robots/POPULATION_K   ten seconds of log of robot K, and prior and PD adapted to it
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from motorprior.actuator.fleet import fleet_files, load_robot_fleet, nominal_pd
from motorprior.actuator.motor_posterior import POSTERIOR_FILE
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.bench_folder import record_bench
from motorprior.bench.recording import bench_schedule, record
from motorprior.bounds import seed_of
from motorprior.identification.baselines.pd_fit import IDEAL_PD, RESTARTS, fit_pd
from motorprior.identification.presets import network_steps
from motorprior.logs.motor_log import MotorLog, log_digest
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.priors.adapt import adapt
from motorprior.priors.fit_prior import PRIOR_FILE, fit_prior
from motorprior.progress import SILENT, Progress, in_parallel
from motorprior.robots.load import load_robot
from motorprior.stage import description, is_finished, working
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, OUT_OF_FAMILY, motors_of_robot
from motorprior.studies.study_settings import CONDITIONS, PDS, VALIDATION, Study, condition_of

FIT = "fit.json"  # constants and error of a PD
LOG = "log.parquet"  # log of a robot
LOG_SECONDS = 10.0  # duration of a robot's log for adaptation [s]
LOG_STREAM = 0x20B2  # tag of the random stream of these logs

PAPER_SCHEDULE = "paper"  # schedule of the bench's log to which the paper's prior is fitted
SCHEDULE = "rollout"  # schedule of the bench's log to which all other models are fitted


def record_benches(bench: Study, progress: Progress) -> dict[str, MotorLog]:
    """Record the motors of a bench; returns the logs by excitation.

    An excitation is recorded only if the model of a training condition is fitted to its log.
    """
    models = {condition.prior or condition.pd for condition in bench.fitted}
    schedule_names = []
    if "paper" in models:
        schedule_names.append(PAPER_SCHEDULE)
    if models - {"paper"}:
        schedule_names.append(SCHEDULE)

    logs = {}
    for name in schedule_names:
        logs[name] = record_bench(
            bench.robot,
            bench.fleet,
            motors=bench.motors,
            steps=bench.bench_steps,
            preset=name,
            seed=bench.seed,
            out=bench.out / "bench" / name,
            progress=progress,
        )
    return logs


def fit_models(benches: Sequence[Study], threads: int, progress: Progress) -> None:
    """Record the benches' motors; identify the priors, and fit the PDs, of the conditions."""
    works = []
    for bench in benches:
        logs = record_benches(bench, progress)

        # the presets that take the longest first
        presets = {condition.prior for condition in bench.fitted if condition.prior}
        for preset in sorted(presets, reverse=True):
            log = logs[PAPER_SCHEDULE if preset == "paper" else SCHEDULE]
            works.append(partial(_fit_prior, bench, log, preset))

        pd_names = set()
        for condition in bench.fitted:
            if condition.pd and not condition.adapted:
                pd_names.add(condition.pd)
        if pd_names:
            works.append(partial(_fit_pds, bench, logs[SCHEDULE], bench.out / "fits", pd_names))
    in_parallel(works, threads, progress)


def _fit_prior(bench: Study, log: MotorLog, preset: str, progress: Progress) -> None:
    steps = network_steps(preset, bench.adam_steps)
    out = prior_path(bench, preset).parent
    fit_prior(log, preset, bench.seed, steps=steps, out=out, progress=progress)


def prior_path(bench: Study, preset: str) -> Path:
    """File of the prior of a preset."""
    return bench.out / "priors" / preset / PRIOR_FILE


def _fit_pds(
    bench: Study, log: MotorLog, folder: Path, pd_names: set[str], progress: Progress
) -> None:
    """Fit these PDs to a log with known loads; the file FIT of each has constants and error."""
    robot = load_robot(bench.robot)
    nominal = nominal_pd(load_robot_fleet(robot, bench.fleet), 1)
    start = {name: float(getattr(nominal, name)[0]) for name in IDEAL_PD}

    for name in sorted(pd_names):
        out = folder / name
        settings = {"start": start, "kind": name, "log": log_digest(log)}
        stage_description = description("study", settings, robot.files)
        if is_finished(out, stage_description):
            continue
        with (
            working(out, stage_description),
            progress.start(f"fit the PD {name}", RESTARTS) as task,
        ):
            fit = fit_pd(log, PDS[name], start, task.advance)
            write_json(out / FIT, asdict(fit))


def robots_of(bench: Study) -> list[tuple[Study, str, int]]:
    """The robots (bench, population, number) that policies of a bench are adapted to."""
    if not any(condition.adapted for condition in bench.fitted):
        return []
    populations = {ENVIRONMENTS[name].population for name in bench.environments}
    robots = []
    for number in sorted({bench.robot_number(seed) for seed in range(bench.seeds)}):
        for population in (IN_FAMILY, OUT_OF_FAMILY):
            if population in populations:
                robots.append((bench, population, number))
    return robots


def adapt_robots(
    robots: Iterable[tuple[Study, str, int]], threads: int, progress: Progress
) -> None:
    """Record a log of LOG_SECONDS of each robot (bench, population, number), and adapt to it."""
    in_parallel([partial(_adapt, *robot) for robot in robots], threads, progress)


def _adapt(bench: Study, population: str, number: int, progress: Progress) -> None:
    robot = load_robot(bench.robot)
    fleet_name = bench.fleet_of(population)
    folder = _robot_folder(bench, population, number)
    adapts_prior = any(condition.adapted and condition.prior for condition in bench.fitted)
    prior_files = [prior_path(bench, "rollout")] if adapts_prior else []

    settings = {"study": bench.seed, "robot": number, "seconds": LOG_SECONDS}
    files = [*prior_files, *fleet_files(robot, fleet_name), *robot.files]
    stage_description = description("study", settings, files)
    if not is_finished(folder, stage_description):
        title = f"bench {bench.seed}: adapt to robot {folder.name}"
        with working(folder, stage_description), progress.start(title, 1):
            log = _record_robot(bench, population, number)
            write_log(folder / LOG, log)
            for file in prior_files:
                prior = MotorPrior.load(file)
                posterior = adapt(prior, log, allow_outliers=True, progress=SILENT)
                posterior.save(folder / POSTERIOR_FILE)

    # settings are selected with adapted priors only
    if "adapted_pd" in bench.conditions and population != VALIDATION:
        log = read_parquet(folder / LOG)
        _fit_pds(bench, log, folder / "fits", {CONDITIONS["adapted_pd"].pd}, progress)


def _record_robot(bench: Study, population: str, number: int) -> MotorLog:
    """A log of LOG_SECONDS of the motors of a robot."""
    robot = load_robot(bench.robot)
    fleet = load_robot_fleet(robot, bench.fleet_of(population))
    schedule = bench_schedule("adapt").for_robot(robot)
    motors = motors_of_robot(robot, fleet, bench.seed, number)
    steps = round(LOG_SECONDS / schedule.period)
    log_seed = seed_of(LOG_STREAM, bench.seed, number)
    return record(motors, schedule, steps, log_seed, fleet)


def _robot_folder(bench: Study, population: str, number: int) -> Path:
    return bench.out / "robots" / f"{population}_{number}"


def motors_of_condition(bench: Study, name: str, population: str, number: int) -> str:
    """Motors of a training condition, as a text for `walk --motors`.

    They are a model that was fitted to the bench, a model that was adapted to the log of robot
    ``number``, or (oracle) the population of motors itself.
    """
    condition = condition_of(name)
    if condition.motors:
        return condition.motors

    robot_folder = _robot_folder(bench, population, number)

    if condition.pd:
        folder = robot_folder if condition.adapted else bench.out
        fit = read_json(folder / "fits" / condition.pd / FIT)
        pd_range = bench.pd_range if name == "random_pd" else None
        return motor_text("pd", spread=pd_range, **fit["constants"])

    if not condition.prior:
        return motor_text("fleet", fleet=bench.fleet_of(population))

    prior = prior_path(bench, condition.prior)
    if condition.adapted:
        posterior = robot_folder / POSTERIOR_FILE
        options = condition.options or {"prior_share": bench.prior_share}
        return motor_text("posterior", file=posterior, prior=prior, **options)
    return motor_text("prior", file=prior, **condition.options)
