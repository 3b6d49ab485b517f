"""Closed-loop fidelity of motor priors against the physical motors they learned from."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import MotorParameters
from motorprior.artifacts import write_json
from motorprior.bench.facts import BenchFacts, facts_from_json
from motorprior.bench.fleet import Fleet
from motorprior.bench.record import bench_preset, record
from motorprior.bounds import require_seed
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.validate import (
    HELD_OUT,
    ModelOfMotors,
    Prediction,
    bench_errors,
)
from motorprior.pipeline.fidelity_traces import write_traces
from motorprior.pipeline.motor_choice import load_prior, nominal_pd
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import description, is_finished, read_figures, seconds_of, working
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.transfer.metrics import BENCH_METRICS, COLUMNS
from motorprior.transfer.robot_fidelity import robot_fidelity

FIGURES, TRACES, QUANTILES = "figures.json", "traces.safetensors", "behaviour_quantiles.png"
SHORTEST_LOG, LONGEST_LOG = 1.0, 600.0
"""Log of a new motor [s]."""
GAINS_FILE, TUNED = "ideal_pd.json", "tuned_pd.json"
"""The PD with the best gains and nothing else, and the PD with armature and delay fitted as well."""


@dataclass(frozen=True)
class Validate:
    """Measure how far simulated motors are from the physical ones, in closed loop, on held-out excitation."""

    priors: tuple[Path, ...]
    """Prior files that `motorprior identify` wrote, all from benches of the same motors."""
    out: Path
    """Folder for figures.json, tuned_pd.json and the traces of the report."""
    seed: int = 0
    """Draws the held-out excitation."""
    held_out: bool = True
    """Measure on motors nobody trained on, too, and whether the prior's draws are like them (a minute more)."""
    adapt_seconds: tuple[float, ...] = (2.0, 5.0, 10.0, 30.0)
    """Lengths of log [s] from which held-out motors are adapted to."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def load_priors(robot: Robot, paths: tuple[Path, ...]) -> tuple[dict[str, MotorPrior], BenchFacts]:
    """The priors by preset, and the bench whose motors they learned.

    Raises:
        ArtifactError: a file that is no prior.
        ConfigError: two of the same preset, of different motors, or of too few for a robot.
    """
    priors: dict[str, MotorPrior] = {}
    facts: list[BenchFacts] = []
    for path in paths:
        prior = load_prior(path, robot)
        if prior.preset in priors:
            raise ConfigError(f"two priors of preset {prior.preset!r}", where=path, remedy="give one of each")
        priors[prior.preset] = prior
        facts.append(facts_from_json(prior.provenance.get("bench"), str(path)))
        same = (facts[-1].fleet, facts[-1].motors, facts[-1].seed) == (
            facts[0].fleet,
            facts[0].motors,
            facts[0].seed,
        )
        if not same:
            raise ConfigError(
                f"its bench is not that of {paths[0]}", where=path, remedy="give priors of the same motors"
            )
    if not facts:
        raise ConfigError("no prior given", remedy="give the prior.safetensors of at least one identify run")
    if robot.legs and facts[0].motors < robot.num_joints:
        raise ConfigError(
            f"its bench has {facts[0].motors} motors, the robot needs {robot.num_joints}", where=paths[0],
            remedy=f"record a bench of {robot.num_joints} motors or more",
        )  # fmt: skip
    return priors, facts[0]


def _models(fleet: Fleet, priors: dict[str, MotorPrior], tuned: IdealPd) -> dict[str, ModelOfMotors]:
    from motorprior.identification.baselines import repeated

    models: dict[str, ModelOfMotors] = {
        "ideal_pd": lambda index: nominal_pd(fleet, len(index)),
        "tuned_pd": lambda index: repeated(tuned, len(index)),
    }
    return models | {name: prior.training_motors for name, prior in priors.items()}


def run_validate(config: Validate, progress: Progress = SILENT) -> dict[str, float]:
    """Measure, or read what this very measurement found; returns the figures.

    Raises:
        ArtifactError, ConfigError: a prior or a setting that cannot be used.
    """
    require_seed(config.seed)
    for seconds in config.adapt_seconds:
        if not SHORTEST_LOG <= seconds <= LONGEST_LOG:
            raise ConfigError(
                f"adapt_seconds {seconds:g} s is not from {SHORTEST_LOG:g} to {LONGEST_LOG:g} s",
                remedy="give lengths of log in between",
                argument="adapt_seconds",
            )
    robot = load_robot(config.robot)
    priors, facts = load_priors(robot, config.priors)
    wanted = description("validate", asdict(config), [*config.priors, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            _measure(config, robot, priors, facts, progress)
    return read_figures(config.out / FIGURES)


def _measure(
    config: Validate, robot: Robot, priors: dict[str, MotorPrior], facts: BenchFacts, progress: Progress
) -> None:
    motors = facts.physical_motors()
    tuned = _tune_baselines(config.out, robot, motors, facts, progress)
    models = _models(facts.fleet, priors, tuned)
    with progress.start("validate: bench, standing robot, hung robot", 4) as task:
        figures = fidelity_figures(robot, motors, models, config.seed, task) | _armature_figures(motors, priors)
        write_traces(config.out / TRACES, robot, motors, models, priors, config.seed)
        task.advance()
    if config.held_out:
        figures |= _held_out_figures(config, robot, priors, facts, tuned, figures, progress)
    figures |= _residual_figures(priors)
    figures |= _identify_seconds(dict(zip(priors, config.priors, strict=True)))
    write_json(config.out / FIGURES, figures)


def _identify_seconds(paths: dict[str, Path]) -> dict[str, float]:
    """How long each identification took [s], where its folder says so; that of rollout also without its name."""
    figures: dict[str, float] = {}
    for name, path in paths.items():
        with suppress(ArtifactError):
            figures[f"identify_seconds/{name}"] = seconds_of(path.parent)
    if "identify_seconds/rollout" in figures:
        figures["identify_seconds"] = figures["identify_seconds/rollout"]
    return figures


def _held_out_figures(
    config: Validate,
    robot: Robot,
    priors: dict[str, MotorPrior],
    facts: BenchFacts,
    tuned: IdealPd,
    train: dict[str, float],
    progress: Progress,
) -> dict[str, float]:
    """The same metrics as METRIC/MODEL/held_out beside METRIC/MODEL/train; adaptation and distribution of rollout."""
    from motorprior.pipeline import held_out  # here: it imports JAX

    paths = dict(zip(priors, config.priors, strict=True))
    both = (*COLUMNS, *(_mean(name) for name in COLUMNS))
    figures = {f"{name}/train": value for name, value in train.items() if name.partition("/")[0] in both}
    title = "held-out motors: adapt, bench, standing robot, hung robot"
    with progress.start(title, 4 + len(config.adapt_seconds)) as task:
        motors = held_out.held_out_motors(facts)
        known = held_out.adapt_all(robot, priors, paths, motors, facts)
        models = _models(facts.fleet, priors, tuned) | held_out.adapted_models(priors, known, len(motors))
        task.advance()
        found = fidelity_figures(robot, motors, models, config.seed, task)
        figures |= {f"{name}/held_out": value for name, value in found.items() if name.partition("/")[0] in both}
        if "rollout" in known:
            prior, path = priors["rollout"], paths["rollout"]
            figures |= held_out.adaptation_figures(
                robot, prior, path, facts, config.adapt_seconds, known["rollout"], config.seed, task.advance
            )
            figures |= held_out.distribution_figures(prior, facts, config.out / QUANTILES)
    return figures


def _tune_baselines(out: Path, robot: Robot, motors: MotorParameters, facts: BenchFacts, progress: Progress) -> IdealPd:
    """Fit both PDs to the bench log, write them, and return the tuned one."""
    # Imported here: scipy's optimizers take half a second.
    from motorprior.identification.baselines import EVALUATIONS, EVERYTHING, GAINS, fit_pd

    nominal = nominal_pd(facts.fleet, 1)
    with progress.start("tune the PD baselines on the bench log", 2 * EVALUATIONS) as task:
        log = record(motors, bench_preset("rollout").for_robot(robot), facts.steps, facts.seed, facts.fleet)
        best_gains, tuned = (fit_pd(log, nominal, free, task.advance) for free in (GAINS, EVERYTHING))
    for name, model in ((GAINS_FILE, best_gains), (TUNED, tuned)):
        write_json(out / name, {key: float(value[0]) for key, value in asdict(model).items()})
    return tuned


def fidelity_figures(
    robot: Robot, motors: MotorParameters, models: Mapping[str, Prediction], seed: int, task: Task
) -> dict[str, float]:
    """METRIC/MODEL on the bench and, with legs, in the standing and the hung robot; three advances of ``task``."""
    figures: dict[str, float] = {}
    errors = bench_errors(motors, models, seed, HELD_OUT.for_robot(robot))
    for metric, kind in BENCH_METRICS.items():
        for model, values in errors[kind].items():
            figures[f"{metric}/{model}"] = float(np.median(values))
            figures[f"{_mean(metric)}/{model}"] = float(np.mean(values))
    task.advance()
    for place, hung in (("standing", False), ("hung", True)) if robot.legs else ():
        found = robot_fidelity(robot, motors, models, hung, seed)
        for model in found.rmse:
            figures[f"{place}_rmse/{model}"] = float(np.median(found.rmse[model]))
            figures[f"{_mean(f'{place}_rmse')}/{model}"] = float(np.mean(found.rmse[model]))
            figures[f"{place}_torque_hf/{model}"] = _finite(np.median(found.torque_hf[model]))
            figures[f"{_mean(f'{place}_torque_hf')}/{model}"] = _finite(np.mean(found.torque_hf[model]))
            if not hung:
                figures[f"standing_displacement_error/{model}"] = _finite(np.median(found.displacement_error[model]))
        task.advance()
    return figures


def _mean(column: str) -> str:
    """Name of the mean beside a median."""
    return f"{column}_mean"


def _armature_figures(motors: MotorParameters, priors: dict[str, MotorPrior]) -> dict[str, float]:
    """How the decoded armature compares with the rotors' own: mean ratio, and correlation over the motors."""
    figures: dict[str, float] = {}
    for name, prior in priors.items():
        if prior.network.has_armature or prior.network.motor is not None:
            decoded = prior.network.armature(prior.mean)
            figures[f"armature_ratio/{name}"] = float(np.mean(decoded / motors.armature))
            if np.ptp(decoded) > 0 and np.ptp(motors.armature) > 0:
                figures[f"armature_correlation/{name}"] = float(np.corrcoef(decoded, motors.armature)[0, 1])
    return figures


def _residual_figures(priors: dict[str, MotorPrior]) -> dict[str, float]:
    """What the network of a grey box adds to a switched-off motor over a cycle, over what the physics take; worst."""
    from motorprior.identification.passivity import residual_bound, residual_work

    figures: dict[str, float] = {}
    for name, prior in priors.items():
        if prior.network.motor is not None:
            motors = prior.training_motors(np.arange(len(prior.mean)))
            figures[f"residual_work/{name}"] = residual_work(motors)
            figures[f"residual_bound/{name}"] = residual_bound(prior.network)
    return figures


def _finite(value: Any) -> float:
    """Infinity (the simulation broke down) as the largest number JSON can hold."""
    return float(min(value, np.finfo(np.float64).max))
