"""What the policies of a study are trained on: one bench, what was fitted to it, and what the oracle knows."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from motorprior.artifacts import read_json
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import seed_of
from motorprior.exceptions import ConfigError
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice, load_robot_fleet
from motorprior.pipeline.progress import Progress, Task
from motorprior.pipeline.stage import in_parallel
from motorprior.pipeline.transfer_study.condition import NOTHING, Condition, fleet_of
from motorprior.pipeline.transfer_study.study_pds import FITTED, ROBOT_PD, fit_pds, fit_robot_pd
from motorprior.pipeline.transfer_study.study_settings import FITS, Study
from motorprior.robots.load import load_robot
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.transfer.places import ABROAD, HOME, TWINS, motors_of_robot
from motorprior.transfer.study_verdicts import (
    ADAPTED,
    OF_ONE_ROBOT,
    ONE_NETWORK,
    ORACLE,
    PAPER,
    PAPER_WIDE,
    PD_ADAPTED,
    PD_FRICTION,
    PD_RANDOMISED,
    PRIOR_MEAN,
    ROBUST_PRIOR,
    UNTRAINED,
)
from motorprior.transfer.study_verdicts import PRIOR as SAMPLED

LOG_SECONDS = 10.0
"""Log of a robot that its policy is adapted to [s]."""
LOG_STREAM = 0x20B2
"""Tag of the random stream of the excitation and the noise of such a log, of no bench."""
_OTHER_PRESETS = (PAPER, PAPER_WIDE, ONE_NETWORK)
"""Conditions that have the name of the preset of their prior; those of the prior are identified by rollout."""


def learn(config: Study, threads: int, progress: Progress) -> None:
    """Record the benches; identify the priors and fit the PDs that are needed, side by side, the longest first."""
    presets = [preset for preset in ("rollout", *_OTHER_PRESETS) if _needs(config, _conditions_of(preset))]
    fitted = _needs(config, (*FITTED, PD_RANDOMISED))
    benches = [_bench_of(preset) for preset in presets] + ["rollout"] * fitted
    for name in dict.fromkeys(benches):
        run_bench(
            Bench(
                config.out / "bench" / name, config.fleet, name, config.motors, config.bench_steps, config.seed,
                config.robot,
            ),
            progress,
        )  # fmt: skip
    works = [partial(_identify, config, preset) for preset in presets] + [partial(fit_pds, config)] * fitted
    in_parallel(works, threads, progress)


def _needs(config: Study, names: Iterable[str]) -> bool:
    return any(name in config.conditions for name in names)


def _conditions_of(preset: str) -> tuple[str, ...]:
    """The conditions that a prior is for."""
    return (preset,) if preset in _OTHER_PRESETS else (PRIOR_MEAN, SAMPLED, ADAPTED, ROBUST_PRIOR)


def _bench_of(preset: str) -> str:
    return "paper" if preset == "paper" else "rollout"


def _identify(config: Study, preset: str, progress: Progress) -> None:
    bench = config.out / "bench" / _bench_of(preset)
    run_identify(Identify(bench, _prior(config, preset).parent, preset, config.seed, config.adam_steps), progress)


def _prior(config: Study, preset: str) -> Path:
    return config.out / "priors" / preset / PRIOR


def conditions(config: Study, seed: int) -> list[Condition]:
    """Of ``config.conditions`` those of the policies of a seed, the longest first; only the first has the gait."""
    z = config.latent_spread
    made = {
        ORACLE: [partial(_oracle, config, population) for population in (ABROAD, HOME)],
        ADAPTED: [partial(_adapted, config, population, seed) for population in (ABROAD, HOME)],
        PD_ADAPTED: [partial(_adapted_pd, config, population, seed) for population in (ABROAD, HOME)],
        SAMPLED: [partial(_sampled_prior, config, z, SAMPLED)],
        ROBUST_PRIOR: [partial(_sampled_prior, config, z, ROBUST_PRIOR, ROBUST)],
        PRIOR_MEAN: [partial(_sampled_prior, config, 0.0, PRIOR_MEAN)],
        **{name: [partial(_other_prior, config, name)] for name in _OTHER_PRESETS},
        **{name: [partial(_pd, config, name, name)] for name in FITTED},
        UNTRAINED: [partial(_untrained, config)] if seed == 0 else [],
        PD_RANDOMISED: [partial(_rival, config)],
    }
    return [make() for name, makes in made.items() if name in config.conditions for make in makes]


def _sampled_prior(config: Study, spread: float, name: str, randomization: Randomization = NOTHING) -> Condition:
    """Motors of the rollout prior, z drawn ``spread`` times as wide as its motors differ, under a name."""
    motors = MotorChoice("prior", _prior(config, "rollout"), fleet=config.fleet, latent_spread=spread, name=name)
    return Condition(name, motors, randomization)


def _other_prior(config: Study, preset: str) -> Condition:
    """Motors of the prior of another preset, whose name is the condition's."""
    return Condition(preset, MotorChoice("prior", _prior(config, preset), fleet=config.fleet, name=preset))


def _untrained(config: Study) -> Condition:
    return Condition(UNTRAINED, MotorChoice("pd", fleet=config.fleet, name=UNTRAINED))


def _pd(config: Study, fit: str, name: str, spread: float = 0.0) -> Condition:
    constants = read_json(config.out / "fits" / FITS)[fit]["constants"]
    return Condition(name, MotorChoice("pd", fleet=config.fleet, spread=spread, name=name, **constants))


def _rival(config: Study) -> Condition:
    if config.spread is None:
        raise ConfigError(
            "the width of the randomised PD is not known", remedy="choose it first: study_spreads.with_spread"
        )
    return randomised_pd(config, config.spread, PD_RANDOMISED)


def randomised_pd(config: Study, width: float, name: str) -> Condition:
    """The PD with friction, every constant varied by a share ``width`` of itself, under a name."""
    return _pd(config, PD_FRICTION, name, width)


def _twins_of(population: str) -> tuple[str, ...]:
    return tuple(name for name, twin in TWINS.items() if twin.population == population)


def _oracle(config: Study, population: str) -> Condition:
    motors = MotorChoice("fleet", fleet=fleet_of(config, population), name=ORACLE)
    return Condition(ORACLE, motors, twins=_twins_of(population), population=population)


def _adapted(config: Study, population: str, seed: int) -> Condition:
    posterior = _folder(config, population, seed) / POSTERIOR
    motors = MotorChoice("prior", _prior(config, "rollout"), posterior, config.fleet, name=ADAPTED)
    return Condition(ADAPTED, motors, twins=_twins_of(population), robot=seed, population=population)


def _adapted_pd(config: Study, population: str, seed: int) -> Condition:
    constants = read_json(_folder(config, population, seed, PD_ADAPTED) / ROBOT_PD)["constants"]
    motors = MotorChoice("pd", fleet=config.fleet, name=PD_ADAPTED, **constants)
    return Condition(PD_ADAPTED, motors, twins=_twins_of(population), robot=seed, population=population)


def _folder(config: Study, population: str, seed: int, fit: str = "") -> Path:
    """Of what was fitted to the log of a robot: the prior, or another fit."""
    return config.out / "robots" / "_".join(filter(None, (population, str(seed), fit)))


def adapt_robots(config: Study, threads: int, progress: Progress) -> None:
    """Record LOG_SECONDS of the motors of the robot of every seed and population, and fit to them what is needed."""
    if not _needs(config, OF_ONE_ROBOT):
        return
    robots = [(population, seed) for seed in range(config.seeds) for population in (HOME, ABROAD)]
    with progress.start(f"adapt to {len(robots)} robots", len(robots)) as task:
        in_parallel([partial(_adapt, config, *robot, task) for robot in robots], threads, progress)


def _adapt(config: Study, population: str, seed: int, task: Task, progress: Progress) -> None:
    folder = _folder(config, population, seed)
    log = folder.parent / f"{folder.name}.parquet"
    folder.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, _log_of(config, population, seed))
    if ADAPTED in config.conditions:
        run_adapt(Adapt(_prior(config, "rollout"), log, folder, anyway=True, robot=config.robot), progress)
    if PD_ADAPTED in config.conditions:
        fit_robot_pd(config, log, _folder(config, population, seed, PD_ADAPTED), progress)
    task.advance(1, folder.name)


def _log_of(config: Study, population: str, seed: int) -> MotorLog:
    """LOG_SECONDS of the motors of a robot on a bench: under known loads, with their torque measured."""
    robot = load_robot(config.robot)
    fleet, preset = load_robot_fleet(robot, fleet_of(config, population)), bench_preset("adapt").for_robot(robot)
    motors = motors_of_robot(robot, fleet, config.seed, seed)
    return record(motors, preset, round(LOG_SECONDS / preset.period), seed_of(LOG_STREAM, config.seed, seed), fleet)
