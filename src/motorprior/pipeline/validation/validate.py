"""Closed-loop fidelity of motor priors against the physical motors they learned from."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_json
from motorprior.bench.bench_folder import BenchSettings, bench_from_json
from motorprior.bench.families import TrueMotors
from motorprior.bench.fleet import Fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_seed
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.evaluation.bench_fidelity import (
    HELD_OUT,
    ModelOfMotors,
    Prediction,
    bench_errors,
)
from motorprior.pipeline.motor_choice import nominal_pd
from motorprior.pipeline.prior_file import load_prior
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import description, is_finished, read_results, seconds_of, working, write_results
from motorprior.pipeline.validation.fidelity_traces import write_traces
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.transfer.metrics import BENCH_METRICS, COLUMNS
from motorprior.transfer.robot_fidelity import robot_fidelity

TRACES, QUANTILES = "traces.safetensors", "behaviour_quantiles.png"
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
    """Measure on held-out motors, too, and whether the prior's draws are like them (a minute more)."""
    adapt_seconds: tuple[float, ...] = (2.0, 5.0, 10.0, 30.0)
    """Lengths of log [s] from which held-out motors are adapted to."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def load_priors(robot: Robot, paths: tuple[Path, ...]) -> tuple[dict[str, MotorPrior], BenchSettings]:
    """The priors by preset, and the bench whose motors they learned.

    Raises:
        ArtifactError: a file that is no prior.
        ConfigError: two of the same preset, of different motors, or of too few for a robot.
    """
    priors: dict[str, MotorPrior] = {}
    facts: list[BenchSettings] = []
    for path in paths:
        prior = load_prior(path, robot)
        if prior.preset in priors:
            raise ConfigError(f"two priors of preset {prior.preset!r}", where=path, remedy="give one of each")
        priors[prior.preset] = prior
        facts.append(bench_from_json(prior.provenance.get("bench"), str(path)))
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
    from motorprior.identification.baselines.pd_fit import repeated

    models: dict[str, ModelOfMotors] = {
        "ideal_pd": lambda index: nominal_pd(fleet, len(index)),
        "tuned_pd": lambda index: repeated(tuned, len(index)),
    }
    return models | {name: prior.training_motors for name, prior in priors.items()}


def run_validate(config: Validate, progress: Progress = SILENT) -> Results:
    """Measure, or read what this very measurement found.

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
    return read_results(config.out)


def _measure(
    config: Validate, robot: Robot, priors: dict[str, MotorPrior], facts: BenchSettings, progress: Progress
) -> None:
    motors = facts.physical_motors()
    tuned = _tune_baselines(config.out, robot, motors, facts, progress)
    models = _models(facts.fleet, priors, tuned)
    with progress.start("validate: bench, standing robot, suspended robot", 4) as task:
        results = fidelity(robot, motors, models, "train", config.seed, task) + _armature(motors, priors)
        write_traces(config.out / TRACES, robot, motors, models, priors, config.seed)
        task.advance()
    if config.held_out:
        results += _held_out(config, robot, priors, facts, tuned, progress)
    results += _residuals(priors)
    results += _identify_seconds(dict(zip(priors, config.priors, strict=True)))
    write_results(config.out, results)


def _identify_seconds(paths: dict[str, Path]) -> Results:
    """How long each identification took, where its folder says so."""
    rows: list[Result] = []
    for name, path in paths.items():
        with suppress(ArtifactError):
            rows.append(Result("identify_seconds", "s", seconds_of(path.parent), model=name))
    return Results.of(rows)


def _held_out(
    config: Validate,
    robot: Robot,
    priors: dict[str, MotorPrior],
    facts: BenchSettings,
    tuned: IdealPd,
    progress: Progress,
) -> Results:
    """The same quantities on other motors; adaptation and distribution of a prior of physics."""
    from motorprior.pipeline.validation import held_out  # here: it imports JAX

    paths = dict(zip(priors, config.priors, strict=True))
    title = "held-out motors: adapt, bench, standing robot, suspended robot"
    with progress.start(title, 4 + len(config.adapt_seconds)) as task:
        motors = held_out.held_out_motors(facts)
        known = held_out.adapt_all(robot, priors, paths, motors, facts)
        models = _models(facts.fleet, priors, tuned) | held_out.adapted_models(priors, known, len(motors))
        task.advance()
        results = fidelity(robot, motors, models, "held_out", config.seed, task).where(quantity=COLUMNS)
        if name := _of_physics(priors, known):
            prior, path = priors[name], paths[name]
            results += held_out.adaptation(
                robot, prior, path, facts, config.adapt_seconds, known[name], config.seed, task.advance
            )
            results += held_out.distribution(prior, facts, config.out / QUANTILES)
    return results


def _of_physics(priors: Mapping[str, MotorPrior], known: Collection[str]) -> str | None:
    """Name of the prior of physics that is looked at closer: rollout, or the first that can be adapted."""
    able = [name for name, prior in priors.items() if name in known and prior.network.motor is not None]
    return "rollout" if "rollout" in able else next(iter(able), None)


def _tune_baselines(out: Path, robot: Robot, motors: TrueMotors, facts: BenchSettings, progress: Progress) -> IdealPd:
    """Fit both PDs to the bench log, write them, and return the tuned one."""
    # Imported here: scipy's optimizers take half a second.
    from motorprior.identification.baselines.pd_fit import GAINS_ALONE, TUNING, best_gains, tuned_pd

    nominal = nominal_pd(facts.fleet, 1)
    with progress.start("tune the PD baselines on the bench log", GAINS_ALONE + TUNING) as task:
        log = record(motors, bench_preset("rollout").for_robot(robot), facts.steps, facts.seed, facts.fleet)
        gains, tuned = best_gains(log, nominal, task.advance), tuned_pd(log, task.advance)
    for name, model in ((GAINS_FILE, gains), (TUNED, tuned)):
        write_json(out / name, {key: float(value[0]) for key, value in asdict(model).items()})
    return tuned


def fidelity(
    robot: Robot, motors: TrueMotors, models: Mapping[str, Prediction], motor_set: str, seed: int, task: Task
) -> Results:
    """Medians and means of `COLUMNS` and the displacement error of the base; three advances of ``task``."""
    rows: list[Result] = []

    def add(quantity: str, unit: str, model: str, values: np.ndarray, mean: bool = True) -> None:
        statistics = {"median": np.median, "mean": np.mean} if mean else {"median": np.median}
        for statistic, of in statistics.items():
            rows.append(Result(quantity, unit, _finite(of(values)), model, motor_set, statistic))

    errors = bench_errors(motors, models, seed, HELD_OUT.for_robot(robot))
    for quantity, kind in BENCH_METRICS.items():
        for model, values in errors[kind].items():
            add(quantity, "rad", model, values)
    task.advance()
    for place, suspended in (("standing", False), ("suspended", True)) if robot.legs else ():
        found = robot_fidelity(robot, motors, models, suspended, seed)
        for model in found.rmse:
            add(f"{place}_rmse", "rad", model, found.rmse[model])
            add(f"{place}_torque_hf", "N·m", model, found.torque_hf[model])
            if not suspended:
                add("standing_displacement_error", "m", model, found.displacement_error[model], mean=False)
        task.advance()
    return Results.of(rows)


def _armature(motors: TrueMotors, priors: dict[str, MotorPrior]) -> Results:
    """How the decoded armature compares with the rotors' own: mean ratio, and correlation over the motors."""
    rows: list[Result] = []
    for name, prior in priors.items():
        if prior.network.has_armature or prior.network.motor is not None:
            decoded = prior.network.armature(prior.mean)
            ratio = float(np.mean(decoded / motors.armature))
            rows.append(Result("armature_ratio", "1", ratio, name, "train"))
            if np.ptp(decoded) > 0 and np.ptp(motors.armature) > 0:
                correlation = float(np.corrcoef(decoded, motors.armature)[0, 1])
                rows.append(Result("armature_correlation", "1", correlation, name, "train"))
    return Results.of(rows)


def _residuals(priors: dict[str, MotorPrior]) -> Results:
    """What the network of a grey box adds to a switched-off motor over a cycle, over what the physics take; worst."""
    from motorprior.identification.evaluation.passivity import residual_bound, residual_work

    rows: list[Result] = []
    for name, prior in priors.items():
        if prior.network.motor is not None:
            motors = prior.training_motors(np.arange(len(prior.mean)))
            rows.append(Result("residual_work", "1", residual_work(motors), name, "train"))
            rows.append(Result("residual_bound", "1", residual_bound(prior.network), name, "train"))
    return Results.of(rows)


def _finite(value: Any) -> float:
    """Infinity (the simulation broke down) as the largest number JSON can hold."""
    return float(min(value, np.finfo(np.float64).max))
