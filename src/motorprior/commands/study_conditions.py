"""Settings of the transfer study, and its training conditions.

Conditions are motor models fitted to one bench or to logs of single robots, and the oracle.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, NOISY, OUT_OF_FAMILY, motors_of_robot
from motorprior.studies.summary import ADAPTED, CONDITIONS, FROZEN

# of every training in addition to the motors: the sensor noise of the environments, and pushes, since policies trained
# without any disturbance walk on a limit cycle that the smallest error leaves
TRAINING = replace(NOISY, push=0.3, push_interval=1.0)
PER_POPULATION = ("oracle", *ADAPTED)  # trained, and evaluated, for motors of one population
FITTED_PDS = {"ideal_pd": GAINS, "tuned_pd": WITH_ROTOR, "friction_pd": WITH_FRICTION}  # to the bench; their constants
PRESETS = {name: name for name in ("paper", "paper_wide")} | dict.fromkeys(
    ("central_motor", "sampled_prior", "adapted_prior", "robust_prior", *FROZEN), "rollout"
)  # condition -> preset of its prior
LOG_SECONDS = 10.0  # of the log of a robot, for adaptation
LOG_STREAM = 0x20B2  # random stream of these logs
FITS = "fits.json"
VALIDATION = "validation"  # population of the validation fleet
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
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)
    """Environments of the evaluation, some of those of docs/transfer.md."""
    benches: int = 4
    """Benches, each with its own motors, robots, floors and pushes: with the seed `seed` and the following ones."""
    seeds: int = 4
    """Policies per condition and bench."""
    draws: int = 32
    """Walks of each policy per environment."""
    robots: int | None = None
    """Robots of each population with an adapted prior and PD; policy k is adapted to robot k modulo this number; one
    per policy if not given."""
    seconds: float = 10.0
    """Duration of a walk [s]."""
    speed: float | None = None
    """Commanded forward speed in training and evaluation [m/s]; 1.5 times the robot's usual maximum if not given: at
    lower speeds the plain gait walks on any motors."""
    iterations: int = 40
    """ARS iterations per policy."""
    directions: int = 14
    """Directions per iteration; the better half of them is used."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose motors the best policy of a search, the range of the randomised PD and
    the share of the adapted prior are selected; no test environment uses it. The first of the robot's other fleets if
    not given."""
    pd_range: float | None = None
    """Relative range of the randomised PD [-]; selected on the validation fleet if not given."""
    prior_share: float | None = None
    """Share of the prior's standard deviation that the adapted prior's motors have in addition to the posterior's [-];
    selected on the validation fleet if not given."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    seed: int = 0
    """Seed of the first bench and its priors; policies of different benches share no search seed."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; with the executor ray, walks of one policy at a time. The result does not depend on it."""
    executor: Kind = "threads"
    """Threads of this process, or walks on Ray's processes."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray."""

    @property
    def commanded(self) -> float:
        """Commanded speed [m/s]. The maximum is that of the robot, not of a policy, which has its own range."""
        return 1.5 * load_robot(self.robot).require_legs().forward[1] if self.speed is None else self.speed

    @property
    def commands(self) -> Commands:
        """Commands of every episode."""
        return Commands.steady(self.commanded)

    def fleet_of(self, population: str) -> str | None:
        """The fleet of a population."""
        if population == VALIDATION:
            return self.validation_fleet(load_robot(self.robot))
        return self.foreign if population == OUT_OF_FAMILY else self.fleet

    def robot_of(self, seed: int) -> int:
        """Number of the robot that the adapted policies of a seed walk on."""
        return seed % self.robots if self.robots else seed

    def of_benches(self) -> list[Study]:
        """The settings of every bench, with its folder and its seed."""
        benches: list[Study] = []
        for seed in range(self.seed, self.seed + self.benches):
            benches.append(replace(self, out=self.out / f"bench_{seed}", seed=seed, benches=1))
        return benches

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
        for name in (name for name in self.conditions if name not in (*CONDITIONS, *FROZEN)):
            try:
                simulated_motors(name, robot)
            except ConfigError as error:
                remedy = f"use some of {', '.join(CONDITIONS)}, or motors as of `walk`"
                raise ConfigError(f"no condition {name!r}", argument="conditions", remedy=remedy) from error
        if unknown := set(self.environments) - set(ENVIRONMENTS):
            remedy = f"use some of {', '.join(ENVIRONMENTS)}"
            raise ConfigError(f"no environments {sorted(unknown)}", argument="environments", remedy=remedy)
        robot.require_legs()
        for name in ("benches", "seeds", "draws", "iterations", "workers"):
            require_count(name, getattr(self, name))
        require_count("motors", self.motors, robot.num_joints)
        require_executor(self.executor, self.ray_address)
        validation = self.validation_fleet(robot)
        used = {load_robot_fleet(robot, self.fleet).name, load_robot_fleet(robot, self.foreign, "foreign").name}
        if len(used) < 2 or (validation and load_robot_fleet(robot, validation, "validation").name in used):
            problem = "fleet, foreign and validation must be three different fleets"
            raise ConfigError(problem, argument="foreign", remedy="change one of them")
        if validation is None and self.to_select():
            problem = f"no fleet of {robot.name!r} to select {', '.join(self.to_select())} on"
            raise ConfigError(problem, argument="validation", remedy="give a validation fleet, or these numbers")

    def to_select(self) -> dict[str, str]:
        """Setting that is selected on the validation fleet -> its condition."""
        settings = {"pd_range": "random_pd", "prior_share": "adapted_prior"}
        return {
            setting: name
            for setting, name in settings.items()
            if name in self.conditions and getattr(self, setting) is None
        }


@dataclass(frozen=True)
class Condition:
    """A policy to train and to evaluate.

    Attributes:
        bench: settings of its bench, see `Study.of_benches`.
        name: of the training condition, in tables.
        seed: of the training.
        motors: of the training episodes.
        randomization: of the training episodes, in addition to the motors.
        population: OUT_OF_FAMILY for conditions trained for out-of-family motors.
        environments: in which it is evaluated.
        robot: number of the only robot that it walks on; all if not given.
    """

    bench: Study
    name: str
    seed: int
    motors: str
    randomization: Randomization = TRAINING
    population: str = IN_FAMILY
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)
    robot: int | None = None

    @property
    def folder(self) -> str:
        """Name of the policy's folder."""
        population = "" if self.population == IN_FAMILY else f"_{self.population}"
        return re.sub(r"[^\w.=-]", "_", f"{self.name}{population}_{self.seed}")


def conditions_of(bench: Study, seed: int) -> list[Condition]:
    """The policies of this seed on a bench."""
    made = []
    for name in bench.conditions:
        robot = bench.robot_of(seed) if name in ADAPTED else None
        randomization = ROBUST if name == "robust_prior" else TRAINING
        for population in (OUT_OF_FAMILY, IN_FAMILY) if name in PER_POPULATION else (IN_FAMILY,):
            within = (population,) if name in PER_POPULATION else (IN_FAMILY, OUT_OF_FAMILY)
            environments = tuple(name for name in bench.environments if ENVIRONMENTS[name].population in within)
            motors = motors_of(bench, name, population, bench.robot_of(seed))
            made.append(Condition(bench, name, seed, motors, randomization, population, environments, robot))
    return made


def motors_of(bench: Study, name: str, population: str, number: int) -> str:
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
    for out in sorted({bench.out / "bench" / "rollout", *logs.values()}):
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
        log = bench.out / "bench" / "rollout" / "log.parquet"
        of_random = {"friction_pd"} if "random_pd" in bench.conditions else set()
        kinds = {name: free for name, free in FITTED_PDS.items() if name in of_random.union(bench.conditions)}
        works.append(partial(_fit_pds, bench, log, bench.out / "fits", kinds))
    in_parallel(works, threads, progress)


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
