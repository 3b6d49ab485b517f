"""Training conditions of a study: motor models fitted to one bench, and the oracle."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_json
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.fleet import fleet_files, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import seed_of
from motorprior.commands.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.transfer_study.settings import Study
from motorprior.identification.fit_prior import PRIOR
from motorprior.logs.formats.parquet_io import read_parquet, write_log
from motorprior.progress import Progress, Task
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import motor_sampler
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.stage import description, in_parallel, is_finished, working
from motorprior.studies.environments import ENVIRONMENTS, IN_FAMILY, OUT_OF_FAMILY, motors_of_robot

MOTORS_ONLY = Randomization()  # only the motors differ between episodes
ADAPTED = ("prior_adapted", "pd_adapted")  # the policy of seed k is fitted to robot k, and walks on it alone
PRESETS = {name: name for name in ("paper", "paper_wide", "one_network")} | dict.fromkeys(
    ("prior_mean", "prior", "prior_adapted", "prior_robust"), "rollout"
)  # condition -> preset of its prior
FITTED_PDS = ("ideal_pd", "tuned_pd", "pd_friction")
# [kg·m²], [s]; each fit starts from all combinations: high inertia and a long delay have similar effects
LAGS = {"armature": (0.001, 0.005), "delay": (0.002, 0.008)}
LOG_SECONDS = 10.0  # of the log of a robot, for adaptation
LOG_STREAM = 0x20B2  # random stream of these logs
FITS = "fits.json"


@dataclass(frozen=True)
class Condition:
    """Training condition of a policy.

    Attributes:
        name: in tables.
        motors: of the training episodes.
        randomization: of the training episodes, in addition to the motors.
        environments: in which it is evaluated.
        robot: number of the only robot that it is evaluated on; None: all.
        population: OUT_OF_FAMILY for conditions trained for out-of-family motors.
    """

    name: str
    motors: str
    randomization: Randomization = MOTORS_ONLY
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)
    robot: int | None = None
    population: str = IN_FAMILY

    def folder(self, seed: int) -> str:
        """Folder name of its policy of a seed."""
        return f"{self.name}_{seed}" if self.population == IN_FAMILY else f"{self.name}_{self.population}_{seed}"

    def is_deterministic(self, robot: Robot) -> bool:
        """Whether all episodes of its training simulation are identical."""
        draw, physics_dt = motor_sampler(self.motors, robot)
        one, other = (draw(np.random.default_rng(seed)).arrays(physics_dt) for seed in (1, 2))
        same = np.array_equal(one.parameters, other.parameters) and np.array_equal(one.biases, other.biases)
        return same and self.randomization == MOTORS_ONLY


def conditions(config: Study, seed: int) -> list[Condition]:
    """The conditions with a policy of this seed, the longest trainings first."""
    z, fleet = config.latent_spread, config.fleet

    def prior(name: str, spread: float = 1.0, randomization: Randomization = MOTORS_ONLY) -> Condition:
        path = prior_path(config, PRESETS[name])
        return Condition(name, motor_text("prior", file=path, latent_spread=spread), randomization)

    def of_robot(name: str, population: str) -> Condition:
        if name == "oracle":
            motors, robot = motor_text("fleet", fleet=fleet_of(config, population)), None
        elif name == "pd_adapted":
            constants = read_json(_robot_folder(config, population, seed, name) / "pd.json")["constants"]
            motors, robot = motor_text("pd", **constants), seed
        else:
            posterior = _robot_folder(config, population, seed) / POSTERIOR
            motors = motor_text("posterior", file=posterior, prior=prior_path(config, "rollout"))
            robot = seed
        environments = tuple(key for key, each in ENVIRONMENTS.items() if each.population == population)
        return Condition(name, motors, environments=environments, robot=robot, population=population)

    made = {
        **{
            name: [partial(of_robot, name, population) for population in (OUT_OF_FAMILY, IN_FAMILY)]
            for name in ("oracle", "prior_adapted", "pd_adapted")
        },
        "prior": [partial(prior, "prior", z)],
        "prior_robust": [partial(prior, "prior_robust", z, ROBUST)],
        "prior_mean": [partial(prior, "prior_mean", 0.0)],
        **{name: [partial(prior, name)] for name in ("paper", "paper_wide", "one_network")},
        **{name: [partial(fitted_pd, config, name)] for name in FITTED_PDS},
        "untrained": [lambda: Condition("untrained", motor_text("pd", fleet=fleet))] * (seed == 0),
        "pd_randomised": [partial(fitted_pd, config, "pd_friction", "pd_randomised", config.spread or 0.0)],
    }
    return [make() for name, makes in made.items() if name in config.conditions for make in makes]


def fitted_pd(config: Study, fit: str, name: str = "", spread: float = 0.0) -> Condition:
    """A PD fitted to the bench; its constants vary by a relative range ``spread``."""
    constants = read_json(config.out / "fits" / FITS)[fit]["constants"]
    return Condition(name or fit, motor_text("pd", spread=spread, **constants))


def fleet_of(config: Study, population: str) -> str | None:
    """The fleet of a population."""
    return config.foreign if population == OUT_OF_FAMILY else config.fleet


def prior_path(config: Study, preset: str) -> Path:
    """The prior of a preset."""
    return config.out / "priors" / preset / PRIOR


def fit_models(config: Study, threads: int, progress: Progress) -> None:
    """Record the benches; identify the priors and fit the PDs that the conditions need."""
    presets = dict.fromkeys(PRESETS[name] for name in ("prior", "paper", "paper_wide", "one_network"))
    presets = [preset for preset in presets if any(PRESETS.get(name) == preset for name in config.conditions)]
    needs_pds = any(name in config.conditions for name in (*FITTED_PDS, "pd_randomised"))
    for name in dict.fromkeys([_bench_of(preset) for preset in presets] + ["rollout"] * needs_pds):
        out = config.out / "bench" / name
        run_bench(
            Bench(out, config.fleet, name, config.motors, config.bench_steps, config.seed, config.robot), progress
        )
    works = [partial(_identify, config, preset) for preset in presets] + [partial(_fit_pds, config)] * needs_pds
    in_parallel(works, threads, progress)


def _bench_of(preset: str) -> str:
    return "paper" if preset == "paper" else "rollout"


def _identify(config: Study, preset: str, progress: Progress) -> None:
    bench = config.out / "bench" / _bench_of(preset)
    run_identify(Identify(bench, prior_path(config, preset).parent, preset, config.seed, config.adam_steps), progress)


def _start(config: Study) -> dict[str, float]:
    """Gains and limit at which each PD fit starts."""
    from motorprior.identification.baselines.pd_fit import GAINS  # here: it imports scipy

    nominal = nominal_pd(load_robot_fleet(load_robot(config.robot), config.fleet), 1)
    return {name: float(getattr(nominal, name)[0]) for name in GAINS}


def _fit_pds(config: Study, progress: Progress) -> None:
    """Fit the three PDs to the bench's log until they converge; FITS has constants, error and effort."""
    from motorprior.identification.baselines.pd_fit import (
        GAINS,
        THOROUGH,
        WITH_FRICTION,
        WITH_ROTOR,
        fit_pd,
        starting_points,
    )

    folder, start, robot = config.out / "fits", _start(config), load_robot(config.robot)
    log = config.out / "bench" / "rollout" / "log.parquet"
    kinds = dict(zip(FITTED_PDS, (GAINS, WITH_ROTOR, WITH_FRICTION), strict=True))
    wanted = description("study", {"start": start, "kinds": kinds}, [log, *robot.files])
    if is_finished(folder, wanted):
        return
    with working(folder, wanted), progress.start("fit the PDs", len(kinds) * THOROUGH.total(4)) as task:
        recorded = read_bench(log.parent)[0]
        fits = {
            name: fit_pd(recorded, starting_points(start, free, LAGS), free, task.advance)
            for name, free in kinds.items()
        }
        for name in [name for name, fit in fits.items() if not fit.converged]:
            progress.note(f"note: the fit of {name} did not converge within its evaluations")
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
    from motorprior.identification.baselines.pd_fit import WITH_FRICTION, fit_pd, starting_points

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
        run_adapt(Adapt(prior_path(config, "rollout"), log, folder, anyway=True, robot=config.robot), progress)
    if "pd_adapted" in config.conditions:
        start, pd_folder = _start(config), _robot_folder(config, population, seed, "pd_adapted")
        wanted = description("study", {"start": start, "kinds": WITH_FRICTION}, [log, *robot.files])
        if not is_finished(pd_folder, wanted):
            with working(pd_folder, wanted):
                fit = fit_pd(read_parquet(log), starting_points(start, WITH_FRICTION, LAGS), WITH_FRICTION)
                write_json(pd_folder / "pd.json", asdict(fit))
    task.advance(1, folder.name)
