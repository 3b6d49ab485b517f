"""Training conditions of a study: motor models fitted to one bench or to logs of single robots, and the oracle."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.fleet import fleet_files, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import seed_of
from motorprior.commands.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.transfer_study.settings import Study
from motorprior.identification.baselines.pd_fit import GAINS, RESTARTS, WITH_FRICTION, WITH_ROTOR, fit_pd
from motorprior.identification.fit_prior import PRIOR
from motorprior.identification.presets import network_steps
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import SILENT, Progress, Task, in_parallel
from motorprior.robots.load import load_robot
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.stage import description, is_finished, working
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, OUT_OF_FAMILY, motors_of_robot
from motorprior.studies.summary import ADAPTED

MOTORS_ONLY = Randomization()  # only the motors differ between episodes
PER_POPULATION = ("oracle", *ADAPTED)  # trained, and evaluated, for motors of one population
FITTED_PDS = ("ideal_pd", "tuned_pd", "pd_friction")
PRESETS = {name: name for name in ("paper", "paper_wide", "one_network")} | dict.fromkeys(
    ("prior_mean", "prior", "prior_adapted", "prior_robust"), "rollout"
)  # condition -> preset of its prior
LONGEST_FIRST = (
    *PER_POPULATION, "prior", "prior_robust", "prior_mean", "paper", "paper_wide", "one_network", *FITTED_PDS,
    "untrained", "pd_randomised",
)  # fmt: skip
FIXED_MOTORS = frozenset({*FITTED_PDS, "pd_adapted", "prior_mean", "one_network"})  # equal in all training episodes
LOG_SECONDS = 10.0  # of the log of a robot, for adaptation
LOG_STREAM = 0x20B2  # random stream of these logs
FITS = "fits.json"


@dataclass(frozen=True)
class Condition:
    """A policy to train and to evaluate.

    Attributes:
        name: of the training condition, in tables.
        seed: of the training; an adapted policy walks on the robot of this number alone.
        motors: of the training episodes.
        randomization: of the training episodes, in addition to the motors.
        population: OUT_OF_FAMILY for conditions trained for out-of-family motors.
        environments: in which it is evaluated.
    """

    name: str
    seed: int
    motors: str
    randomization: Randomization = MOTORS_ONLY
    population: str = IN_FAMILY
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)

    @property
    def folder(self) -> str:
        """Name of the policy's folder."""
        population = "" if self.population == IN_FAMILY else f"_{self.population}"
        return f"{self.name}{population}_{self.seed}"


def conditions_of(config: Study, seed: int) -> list[Condition]:
    """The policies of this seed, the longest trainings first."""
    made = []
    for name in (name for name in LONGEST_FIRST if name in config.conditions):
        if name in PER_POPULATION:
            for population in (OUT_OF_FAMILY, IN_FAMILY):
                motors = _motors(config, name, population, seed)
                environments = tuple(key for key, each in ENVIRONMENTS.items() if each.population == population)
                made.append(Condition(name, seed, motors, population=population, environments=environments))
        elif name != "untrained" or seed == 0:
            randomization = ROBUST if name == "prior_robust" else MOTORS_ONLY
            made.append(Condition(name, seed, _motors(config, name, IN_FAMILY, seed), randomization))
    return made


def _motors(config: Study, name: str, population: str, seed: int) -> str:
    """Motors of a condition: fitted to the bench, to the log of the robot of a seed, or those of a population."""
    if name == "oracle":
        return motor_text("fleet", fleet=fleet_of(config, population))
    if name == "untrained":
        return motor_text("pd", fleet=config.fleet)
    if name == "pd_randomised":
        return randomized_pd(config, config.spread or 0.0)
    if name == "pd_adapted" or name in FITTED_PDS:
        folder = config.out / "fits" if name in FITTED_PDS else _robot_folder(config, population, seed, name)
        return motor_text("pd", **_constants(folder, name))
    prior = prior_path(config, PRESETS[name])
    if name == "prior_adapted":
        return motor_text("posterior", file=_robot_folder(config, population, seed) / POSTERIOR, prior=prior)
    spread = {"prior": config.latent_spread, "prior_robust": config.latent_spread, "prior_mean": 0.0}.get(name, 1.0)
    return motor_text("prior", file=prior, latent_spread=spread)


def randomized_pd(config: Study, spread: float) -> str:
    """The PD with friction; its constants vary by a relative range ``spread``."""
    return motor_text("pd", spread=spread, **_constants(config.out / "fits", "pd_friction"))


def _constants(folder: Path, fit: str) -> dict[str, Any]:
    return read_json(folder / FITS)[fit]["constants"]


def fleet_of(config: Study, population: str) -> str | None:
    """The fleet of a population."""
    return config.foreign if population == OUT_OF_FAMILY else config.fleet


def prior_path(config: Study, preset: str) -> Path:
    """The prior of a preset."""
    return config.out / "priors" / preset / PRIOR


def fit_models(config: Study, threads: int, progress: Progress) -> None:
    """Record the benches; identify the priors and fit the PDs that the conditions need."""
    used = {PRESETS[name] for name in config.conditions if name in PRESETS}
    presets = [preset for preset in ("rollout", "paper", "paper_wide", "one_network") if preset in used]
    needs_pds = any(name in config.conditions for name in (*FITTED_PDS, "pd_randomised"))
    benches = {preset: config.out / "bench" / ("paper" if preset == "paper" else "rollout") for preset in presets}
    rollout = config.out / "bench" / "rollout"
    for out in dict.fromkeys((*benches.values(), rollout) if needs_pds else benches.values()):
        bench = Bench(out, config.fleet, out.name, config.motors, config.bench_steps, config.seed, config.robot)
        run_bench(bench, progress)
    fits = [
        Identify(
            bench, prior_path(config, preset).parent, preset, config.seed, network_steps(preset, config.adam_steps)
        )
        for preset, bench in benches.items()
    ]
    works = [partial(run_identify, fit) for fit in fits]
    if needs_pds:
        works.append(partial(_fit_pds, config, rollout / "log.parquet", config.out / "fits", FITTED_PDS))
    in_parallel(works, threads, progress)


def _fit_pds(config: Study, log: Path, folder: Path, names: tuple[str, ...], progress: Progress) -> None:
    """Fit PDs to a log with known loads; FITS has constants and error."""
    every: dict[str, tuple[str, ...]] = {
        "ideal_pd": GAINS, "tuned_pd": WITH_ROTOR, "pd_friction": WITH_FRICTION, "pd_adapted": WITH_FRICTION
    }  # fmt: skip
    kinds = {name: every[name] for name in names}
    robot = load_robot(config.robot)
    nominal = nominal_pd(load_robot_fleet(robot, config.fleet), 1)
    start = {name: float(getattr(nominal, name)[0]) for name in GAINS}
    wanted = description("study", {"start": start, "kinds": kinds}, [log, *robot.files])
    if is_finished(folder, wanted):
        return
    with working(folder, wanted), progress.start("fit the PDs", len(kinds) * RESTARTS) as task:
        recorded = read_parquet(log)
        fits = {name: fit_pd(recorded, free, start, task.advance) for name, free in kinds.items()}
        write_json(folder / FITS, {name: asdict(fit) for name, fit in fits.items()})


def adapt_robots(config: Study, threads: int, progress: Progress) -> None:
    """Record LOG_SECONDS of the motors of the robot of every seed and population, and adapt to them."""
    if not any(name in config.conditions for name in ADAPTED):
        return
    robots = [(population, seed) for seed in range(config.seeds) for population in (IN_FAMILY, OUT_OF_FAMILY)]
    with progress.start(f"adapt to {len(robots)} robots", len(robots)) as task:
        in_parallel([partial(_adapt, config, *robot, task) for robot in robots], threads, progress)


def _robot_folder(config: Study, population: str, seed: int, fit: str = "") -> Path:
    return config.out / "robots" / "_".join(filter(None, (population, str(seed), fit)))


def _adapt(config: Study, population: str, seed: int, task: Task, progress: Progress) -> None:
    robot, folder = load_robot(config.robot), _robot_folder(config, population, seed)
    fleet, preset = load_robot_fleet(robot, fleet_of(config, population)), bench_preset("adapt").for_robot(robot)
    log = _robot_folder(config, population, seed, "log") / f"{folder.name}.parquet"
    settings = {"study": config.seed, "robot": seed, "seconds": LOG_SECONDS}
    wanted = description("study", settings, [*fleet_files(robot, fleet_of(config, population)), *robot.files])
    if not is_finished(log.parent, wanted):
        with working(log.parent, wanted):
            motors = motors_of_robot(robot, fleet, config.seed, seed)
            steps, log_seed = round(LOG_SECONDS / preset.period), seed_of(LOG_STREAM, config.seed, seed)
            write_log(log, record(motors, preset, steps, log_seed, fleet))
    if "prior_adapted" in config.conditions:
        run_adapt(Adapt(prior_path(config, "rollout"), log, folder, anyway=True), progress)
    if "pd_adapted" in config.conditions:
        _fit_pds(config, log, _robot_folder(config, population, seed, "pd_adapted"), ("pd_adapted",), SILENT)
    task.advance(1, folder.name)
