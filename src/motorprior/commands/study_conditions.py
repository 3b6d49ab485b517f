"""Training conditions of the transfer study: their motors and trainings.

Conditions are motor models fitted to one bench or to logs of single robots, and the oracle.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.fleet import fleet_files, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import seed_of
from motorprior.commands.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.study_settings import VALIDATION, Study
from motorprior.identification.baselines.pd_fit import GAINS, RESTARTS, WITH_FRICTION, WITH_ROTOR, fit_pd
from motorprior.identification.fit_prior import PRIOR
from motorprior.identification.presets import network_steps
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import Progress, in_parallel
from motorprior.robots.load import load_robot
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.stage import description, is_finished, working
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, NOISY, OUT_OF_FAMILY, motors_of_robot
from motorprior.studies.summary import ADAPTED, CONDITIONS, FROZEN

# of every training in addition to the motors: the sensor noise of the environments, and pushes; without any disturbance
# policies overfit one deterministic walk, and fall more often on held-out robots
TRAINING = replace(NOISY, push=0.3, push_interval=1.0)
PER_POPULATION = ("oracle", *ADAPTED)  # trained, and evaluated, for motors of one population
FITTED_PDS = {"ideal_pd": GAINS, "tuned_pd": WITH_ROTOR, "friction_pd": WITH_FRICTION}  # to the bench; their constants
PRESETS = {name: name for name in ("paper", "paper_wide")} | dict.fromkeys(
    ("central_motor", "sampled_prior", "adapted_prior", "robust_prior", *FROZEN), "rollout"
)  # condition -> preset of its prior
LOG_SECONDS = 10.0  # of the log of a robot, for adaptation
LOG_STREAM = 0x20B2  # random stream of these logs
FITS = "fits.json"


@dataclass(frozen=True)
class Condition:
    """A policy to train and to evaluate."""

    bench: Study  # settings of its bench, see `Study.of_benches`
    name: str  # of the training condition, in tables
    seed: int  # of the training
    motors: str  # of the training episodes
    randomization: Randomization = TRAINING  # of the training episodes, in addition to the motors
    population: str = IN_FAMILY  # OUT_OF_FAMILY for conditions trained for out-of-family motors
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)  # in which it is evaluated
    robot: int | None = None  # number of the only robot that it walks on; all if None

    @property
    def folder(self) -> str:
        """Name of the policy's folder."""
        population = "" if self.population == IN_FAMILY else f"_{self.population}"
        return re.sub(r"[^\w.=-]", "_", f"{self.name}{population}_{self.seed}")


def conditions_of(bench: Study, seed: int) -> list[Condition]:
    """The policies of this seed on a bench."""
    made = []
    for name in (name for name in bench.conditions if seed in bench.seeds_of(name)):
        robot = bench.robot_of(seed) if name in ADAPTED else None
        randomization = ROBUST if name == "robust_prior" else TRAINING
        for population in (OUT_OF_FAMILY, IN_FAMILY) if name in PER_POPULATION else (IN_FAMILY,):
            within = (population,) if name in PER_POPULATION else (IN_FAMILY, OUT_OF_FAMILY)
            environments = tuple(each for each in bench.environments if ENVIRONMENTS[each].population in within)
            motors = condition_motors(bench, name, population, bench.robot_of(seed))
            made.append(Condition(bench, name, seed, motors, randomization, population, environments, robot))
    return made


def condition_motors(bench: Study, name: str, population: str, number: int) -> str:
    """Motors of a condition: fitted to the bench or to the log of a robot, or those of a population."""
    if name not in (*CONDITIONS, *FROZEN):
        return name
    if name == "oracle":
        return motor_text("fleet", fleet=bench.fleet_of(population))
    if name == "adapted_pd":
        fits = read_json(_robot_folder(bench, population, number, name) / FITS)
        return motor_text("pd", **fits[name]["constants"])
    if name in (*FITTED_PDS, "random_pd"):
        kind, pd_range = ("friction_pd", bench.pd_range) if name == "random_pd" else (name, None)
        return motor_text("pd", spread=pd_range, **read_json(bench.out / "fits" / FITS)[kind]["constants"])
    prior = prior_path(bench, PRESETS[name])
    if name == "adapted_prior":
        file = _robot_folder(bench, population, number) / POSTERIOR
        return motor_text("posterior", file=file, prior=prior, prior_share=bench.prior_share)
    spread = 0.0 if name == "central_motor" else None
    return motor_text("prior", file=prior, latent_spread=spread, frozen=FROZEN.get(name))


def prior_path(bench: Study, preset: str) -> Path:
    """The prior of a preset."""
    return bench.out / "priors" / preset / PRIOR


def record_benches(bench: Study, progress: Progress) -> dict[str, Path]:
    """Record the motors of a bench; preset -> folder of the logs of its prior, the longest fit first."""
    used = sorted({PRESETS[name] for name in bench.conditions if name in PRESETS}, reverse=True)
    logs = {preset: bench.out / "bench" / ("paper" if preset == "paper" else "rollout") for preset in used}
    of_pds = {bench.out / "bench" / "rollout"} if _fitted_pds(bench) else set()
    for out in sorted(of_pds.union(logs.values())):
        motors, steps = bench.motors, bench.bench_steps
        run_bench(Bench(out, bench.fleet, out.name, motors, steps, bench.seed, bench.robot), progress)
    return logs


def fit_models(benches: Sequence[Study], threads: int, progress: Progress) -> None:
    """Record the motors of the benches; identify the priors and fit the PDs that the conditions need."""
    works = []
    for bench in benches:
        for preset, log in record_benches(bench, progress).items():
            out, steps = prior_path(bench, preset).parent, network_steps(preset, bench.adam_steps)
            works.append(partial(run_identify, Identify(log, out, preset, bench.seed, steps)))
        if kinds := _fitted_pds(bench):
            log = bench.out / "bench" / "rollout" / "log.parquet"
            works.append(partial(_fit_pds, bench, log, bench.out / "fits", kinds))
    in_parallel(works, threads, progress)


def _fitted_pds(bench: Study) -> dict[str, tuple[str, ...]]:
    """PDs that the conditions need, and their fitted constants; the randomised PD is that with friction."""
    needed = {"friction_pd" if name == "random_pd" else name for name in bench.conditions}
    return {name: free for name, free in FITTED_PDS.items() if name in needed}


def _fit_pds(bench: Study, log: Path, folder: Path, kinds: Mapping[str, tuple[str, ...]], progress: Progress) -> None:
    """Fit PDs to a log with known loads; FITS has constants and error."""
    robot = load_robot(bench.robot)
    nominal = nominal_pd(load_robot_fleet(robot, bench.fleet), 1)
    start = {name: float(getattr(nominal, name)[0]) for name in GAINS}
    wanted = description("study", {"start": start, "kinds": kinds}, [log, *robot.files])
    if is_finished(folder, wanted):
        return
    with working(folder, wanted), progress.start("fit the PDs", len(kinds) * RESTARTS) as task:
        recorded = read_parquet(log)
        fits = {name: fit_pd(recorded, free, start, task.advance) for name, free in kinds.items()}
        write_json(folder / FITS, {name: asdict(fit) for name, fit in fits.items()})


def adapt_robots(robots: Iterable[tuple[Study, str, int]], threads: int, progress: Progress) -> None:
    """Record LOG_SECONDS of the motors of robots (bench, population, number), and adapt to them."""
    in_parallel([partial(_adapt, *robot) for robot in robots], threads, progress)


def robots_of(bench: Study) -> list[tuple[Study, str, int]]:
    """The robots that policies of a bench are adapted to."""
    adapted = any(name in bench.conditions for name in ADAPTED)
    numbers = sorted({bench.robot_of(seed) for seed in range(bench.seeds)}) if adapted else []
    return [(bench, population, number) for number in numbers for population in (IN_FAMILY, OUT_OF_FAMILY)]


def _robot_folder(bench: Study, population: str, number: int, fit: str = "") -> Path:
    return bench.out / "robots" / "_".join(filter(None, (population, str(number), fit)))


def _adapt(bench: Study, population: str, number: int, progress: Progress) -> None:
    robot, folder = load_robot(bench.robot), _robot_folder(bench, population, number)
    fleet, preset = load_robot_fleet(robot, bench.fleet_of(population)), bench_preset("adapt").for_robot(robot)
    log = _robot_folder(bench, population, number, "log") / f"{folder.name}.parquet"
    settings = {"study": bench.seed, "robot": number, "seconds": LOG_SECONDS}
    wanted = description("study", settings, [*fleet_files(robot, bench.fleet_of(population)), *robot.files])
    if not is_finished(log.parent, wanted):
        with working(log.parent, wanted):
            motors = motors_of_robot(robot, fleet, bench.seed, number)
            steps, log_seed = round(LOG_SECONDS / preset.period), seed_of(LOG_STREAM, bench.seed, number)
            write_log(log, record(motors, preset, steps, log_seed, fleet))
    if "adapted_prior" in bench.conditions:
        with progress.start(f"bench {bench.seed}: adapt the prior to robot {folder.name}", 1) as task:
            run_adapt(Adapt(prior_path(bench, "rollout"), log, folder, anyway=True))  # silent: fits no PD to compare
            task.advance()
    if "adapted_pd" in bench.conditions and population != VALIDATION:
        out = _robot_folder(bench, population, number, "adapted_pd")
        _fit_pds(bench, log, out, {"adapted_pd": WITH_FRICTION}, progress)
