"""Settings of the transfer study, and its training conditions.

Conditions are motor models fitted to one bench or to logs of single robots, and the oracle.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.fleet import fleet_files, load_fleet, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_count, seed_of
from motorprior.commands.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import GAINS, RESTARTS, WITH_FRICTION, WITH_ROTOR, fit_pd
from motorprior.identification.fit_prior import PRIOR
from motorprior.identification.presets import network_steps
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import Kind, require_executor
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import Progress, in_parallel
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.stage import description, is_finished, working
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, OUT_OF_FAMILY, motors_of_robot
from motorprior.studies.summary import ADAPTED, CONDITIONS

MOTORS_ONLY = Randomization()  # only the motors differ between episodes
PER_POPULATION = ("oracle", *ADAPTED)  # trained, and evaluated, for motors of one population
FITTED_PDS = {"ideal_pd": GAINS, "tuned_pd": WITH_ROTOR, "pd_friction": WITH_FRICTION}  # to the bench; their constants
PRESETS = {name: name for name in ("paper", "paper_wide", "one_network")} | dict.fromkeys(
    ("prior_mean", "prior", "prior_adapted", "prior_robust"), "rollout"
)  # condition -> preset of its prior
FIXED_MOTORS = frozenset({*FITTED_PDS, "pd_adapted", "prior_mean", "one_network"})  # equal in all training episodes
LOG_SECONDS = 10.0  # of the log of a robot, for adaptation
LOG_STREAM = 0x20B2  # random stream of these logs
FITS = "fits.json"
_VALIDATION_FLEETS = ("mixed", "foreign_servo", "foreign_direct")


@dataclass(frozen=True)
class Study:
    """Train on each model of a bench's motors, with several seeds, and evaluate on held-out robots."""

    out: Path
    """Run folder."""
    fleet: str | None = None
    """Population of the bench's motors and of the environment `fleet`; the robot's own if not given."""
    foreign: str = "foreign_direct"
    """Out-of-family population, of the environments `foreign` and `hard`."""
    conditions: tuple[str, ...] = CONDITIONS
    """Training conditions: those of docs/transfer.md, or other motors, as of `walk`."""
    seeds: int = 8
    """Policies per condition."""
    draws: int = 32
    """Walks of each policy per environment."""
    seconds: float = 10.0
    """Duration of a walk [s]."""
    speed: float | None = None
    """Commanded forward speed in training and evaluation [m/s]; 1.5 times the robot's usual maximum if not given: at
    lower speeds the plain gait walks on any motors."""
    iterations: int = 50
    """ARS iterations per policy."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose motors the best policy of a search and the range of the randomised PD are
    selected; no test environment uses it. The first of the robot's other fleets if not given."""
    spread: float | None = None
    """Relative range of the randomised PD [-]; selected on the validation fleet if not given."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    seed: int = 0
    """Seed of the bench and the priors; policies of different studies share no search seed."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; with the executor ray, walks of one policy at a time. The result does not depend on it."""
    executor: Kind = "threads"
    """Threads of this process, or walks on Ray's processes."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray."""

    def commanded(self, robot: Robot) -> float:
        """Commanded speed [m/s]."""
        return 1.5 * robot.require_legs().forward[1] if self.speed is None else self.speed

    def commands(self, robot: Robot) -> Commands:
        """Commands of every episode."""
        return Commands.steady(self.commanded(robot))

    def fleet_of(self, population: str) -> str | None:
        """The fleet of a population."""
        return self.foreign if population == OUT_OF_FAMILY else self.fleet

    def validation_fleet(self, robot: Robot) -> str | None:
        """Fleet that no test environment uses, on which policies are selected; None: select on the training motors."""
        if self.validation is not None:
            return self.validation
        used = {load_robot_fleet(robot, self.fleet).name, load_robot_fleet(robot, self.foreign, "foreign").name}
        others = (name for name in _VALIDATION_FLEETS if name not in used and load_fleet(name).robot == robot.name)
        return next(others, None)

    @property
    def episodes_at_a_time(self) -> int:
        """Walks of one policy at a time; one per thread."""
        return self.workers if self.executor == "ray" else 1

    def require_valid(self) -> None:
        """Check the settings; raises `ConfigError`, which names the invalid one."""
        robot = load_robot(self.robot)
        for name in (name for name in self.conditions if name not in CONDITIONS):
            try:
                simulated_motors(name, robot)
            except ConfigError as error:
                remedy = f"use some of {', '.join(CONDITIONS)}, or motors as of `walk`"
                raise ConfigError(f"no condition {name!r}", argument="conditions", remedy=remedy) from error
        robot.require_legs()
        for name in ("seeds", "draws", "iterations", "workers"):
            require_count(name, getattr(self, name))
        require_count("motors", self.motors, robot.num_joints)
        require_executor(self.executor, self.ray_address)
        validation = self.validation_fleet(robot)
        used = {load_robot_fleet(robot, self.fleet).name, load_robot_fleet(robot, self.foreign, "foreign").name}
        if len(used) < 2 or (validation and load_robot_fleet(robot, validation, "validation").name in used):
            problem = "fleet, foreign and validation must be three different fleets"
            raise ConfigError(problem, argument="foreign", remedy="change one of them")
        if self.spread is None and "pd_randomised" in self.conditions and validation is None:
            problem = f"no fleet of {robot.name!r} to select the range of pd_randomised on"
            raise ConfigError(problem, argument="validation", remedy="give a validation fleet, or a spread")


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
        return re.sub(r"[^\w.=-]", "_", f"{self.name}{population}_{self.seed}")


def conditions_of(config: Study, seed: int) -> list[Condition]:
    """The policies of this seed."""
    made = []
    for name in config.conditions:
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
    if name not in CONDITIONS:
        return name
    if name == "oracle":
        return motor_text("fleet", fleet=config.fleet_of(population))
    if name == "untrained":
        return motor_text("pd", fleet=config.fleet)
    if name == "pd_randomised":
        return randomized_pd(config, config.spread or 0.0)
    if name in FITTED_PDS:
        return motor_text("pd", **read_json(config.out / "fits" / FITS)[name]["constants"])
    if name == "pd_adapted":
        fits = read_json(_robot_folder(config, population, seed, name) / FITS)
        return motor_text("pd", **fits[name]["constants"])
    prior = prior_path(config, PRESETS[name])
    if name == "prior_adapted":
        return motor_text("posterior", file=_robot_folder(config, population, seed) / POSTERIOR, prior=prior)
    return motor_text("prior", file=prior, latent_spread=0.0 if name == "prior_mean" else 1.0)


def randomized_pd(config: Study, spread: float) -> str:
    """The PD with friction; its constants vary by a relative range ``spread``."""
    return motor_text("pd", spread=spread, **read_json(config.out / "fits" / FITS)["pd_friction"]["constants"])


def prior_path(config: Study, preset: str) -> Path:
    """The prior of a preset."""
    return config.out / "priors" / preset / PRIOR


def fit_models(config: Study, threads: int, progress: Progress) -> None:
    """Record the benches; identify the priors and fit the PDs that the conditions need."""
    used = {PRESETS[name] for name in config.conditions if name in PRESETS}
    presets = sorted(used, reverse=True)  # the longest first
    needs_pds = any(name in config.conditions for name in (*FITTED_PDS, "pd_randomised"))
    benches = {preset: config.out / "bench" / ("paper" if preset == "paper" else "rollout") for preset in presets}
    rollout = config.out / "bench" / "rollout"
    for out in dict.fromkeys((*benches.values(), rollout) if needs_pds else benches.values()):
        bench = Bench(out, config.fleet, out.name, config.motors, config.bench_steps, config.seed, config.robot)
        run_bench(bench, progress)
    works = []
    for preset, bench in benches.items():
        out, steps = prior_path(config, preset).parent, network_steps(preset, config.adam_steps)
        works.append(partial(run_identify, Identify(bench, out, preset, config.seed, steps)))
    if needs_pds:
        works.append(partial(_fit_pds, config, rollout / "log.parquet", config.out / "fits", FITTED_PDS))
    in_parallel(works, threads, progress)


def _fit_pds(config: Study, log: Path, folder: Path, kinds: Mapping[str, tuple[str, ...]], progress: Progress) -> None:
    """Fit PDs to a log with known loads; FITS has constants and error."""
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
    in_parallel([partial(_adapt, config, *robot) for robot in robots], threads, progress)


def _robot_folder(config: Study, population: str, seed: int, fit: str = "") -> Path:
    return config.out / "robots" / "_".join(filter(None, (population, str(seed), fit)))


def _adapt(config: Study, population: str, seed: int, progress: Progress) -> None:
    robot, folder = load_robot(config.robot), _robot_folder(config, population, seed)
    fleet, preset = load_robot_fleet(robot, config.fleet_of(population)), bench_preset("adapt").for_robot(robot)
    log = _robot_folder(config, population, seed, "log") / f"{folder.name}.parquet"
    settings = {"study": config.seed, "robot": seed, "seconds": LOG_SECONDS}
    wanted = description("study", settings, [*fleet_files(robot, config.fleet_of(population)), *robot.files])
    if not is_finished(log.parent, wanted):
        with working(log.parent, wanted):
            motors = motors_of_robot(robot, fleet, config.seed, seed)
            steps, log_seed = round(LOG_SECONDS / preset.period), seed_of(LOG_STREAM, config.seed, seed)
            write_log(log, record(motors, preset, steps, log_seed, fleet))
    if "prior_adapted" in config.conditions:
        run_adapt(Adapt(prior_path(config, "rollout"), log, folder, anyway=True), progress)
    if "pd_adapted" in config.conditions:
        _fit_pds(
            config, log, _robot_folder(config, population, seed, "pd_adapted"), {"pd_adapted": WITH_FRICTION}, progress
        )
