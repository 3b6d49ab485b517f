"""``motorprior validate``: closed-loop fidelity of motor priors against the physical motors they learned from."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.artifacts import read_json, write_json, write_tensors
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import Fleet
from motorprior.bench.record import bench_preset, record
from motorprior.cli.bench import BenchFacts, facts_from_json
from motorprior.cli.bounds import require_seed
from motorprior.cli.console import Bar, bar, table
from motorprior.cli.motors import load_prior
from motorprior.cli.stage import begin, description, finish, is_finished
from motorprior.exceptions import ConfigError
from motorprior.identification.validate import (
    ModelOfMotors,
    bench_errors,
    held_out_trials,
    teacher_forced_torque,
)
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.replay import replay
from motorprior.simulation.world import World, WorldConfig
from motorprior.transfer.robot_fidelity import robot_fidelity, trot_targets

FIGURES, TRACES, TUNED = "figures.json", "traces.safetensors", "tuned_pd.json"
BENCH_METRICS = {
    "bench_sine_rmse": "sine",
    "bench_gait_rmse": "gait",
    "bench_steps_rmse": "held_steps",
    "bench_impact_rmse": "impacts",
}
COLUMNS = (*BENCH_METRICS, "standing_rmse", "hung_rmse", "standing_torque_hf", "hung_torque_hf")


@dataclass(frozen=True)
class Validate:
    """Measure how far simulated motors are from the physical ones, in closed loop, on held-out excitation."""

    priors: tyro.conf.Positional[tuple[Path, ...]]
    """Prior files that `motorprior identify` wrote, all from benches of the same motors."""
    out: Path
    """Folder for figures.json, tuned_pd.json and the traces of the report."""
    seed: int = 0
    """Draws the held-out excitation."""


def load_priors(paths: tuple[Path, ...]) -> tuple[dict[str, MotorPrior], BenchFacts]:
    """The priors by preset, and the bench whose motors they learned.

    Raises:
        ArtifactError: a file that is no prior.
        ConfigError: two of the same preset, of different motors, or of too few for a robot.
    """
    priors: dict[str, MotorPrior] = {}
    facts: list[BenchFacts] = []
    for path in paths:
        prior = load_prior(path)
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
    if facts[0].motors < spec.NUM_JOINTS:
        raise ConfigError(
            f"its bench has {facts[0].motors} motors, the robot needs {spec.NUM_JOINTS}", where=paths[0],
            remedy=f"record a bench with --motors {spec.NUM_JOINTS} or more",
        )  # fmt: skip
    return priors, facts[0]


def nominal_pd(fleet: Fleet, num_motors: int) -> IdealPd:
    """The ideal PD: the gains and the torque limit of the fleet's central motor, nothing else."""
    center = fleet.center(1)
    return IdealPd.uniform(num_motors, center.kp[0], center.kd[0], center.torque_limit[0])


def _models(fleet: Fleet, priors: dict[str, MotorPrior], tuned: IdealPd) -> dict[str, ModelOfMotors]:
    from motorprior.identification.baselines import repeated

    models: dict[str, ModelOfMotors] = {
        "ideal_pd": lambda index: nominal_pd(fleet, len(index)),
        "tuned_pd": lambda index: repeated(tuned, len(index)),
    }
    return models | {name: prior.training_motors for name, prior in priors.items()}


def run_validate(config: Validate, show: bool = True) -> dict[str, float]:
    """Measure, or read what this very measurement found; returns the figures.

    Raises:
        ArtifactError, ConfigError: a prior or a setting that cannot be used.
    """
    require_seed(config.seed)
    priors, facts = load_priors(config.priors)
    wanted = description("validate", asdict(config), list(config.priors))
    if not is_finished(config.out, wanted):
        begin(config.out)
        _measure(config, priors, facts)
        finish(config.out, wanted)
    figures = read_json(config.out / FIGURES)
    if show:
        show_fidelity(figures)
    return figures


def _measure(config: Validate, priors: dict[str, MotorPrior], facts: BenchFacts) -> None:
    from motorprior.identification.baselines import fit_tuned_pd  # here: scipy's optimizers take half a second

    motors = facts.physical_motors()
    with bar("tune the PD baseline on the bench log", 200) as progress:
        log = record(motors, bench_preset("rollout"), facts.steps, facts.seed, facts.fleet)
        tuned = fit_tuned_pd(log, nominal_pd(facts.fleet, 1), progress.advance)
    write_json(config.out / TUNED, {name: float(value[0]) for name, value in asdict(tuned).items()})
    models = _models(facts.fleet, priors, tuned)
    with bar("validate: bench, standing robot, hung robot", 4) as progress:
        figures = _figures(motors, models, config.seed, progress)
        _write_traces(config.out / TRACES, motors, models, priors, config.seed)
        progress.advance()
    write_json(config.out / FIGURES, figures)


def _figures(motors: MotorParameters, models: dict[str, ModelOfMotors], seed: int, progress: Bar) -> dict[str, float]:
    figures: dict[str, float] = {}
    errors = bench_errors(motors, models, seed)
    for metric, kind in BENCH_METRICS.items():
        for model, values in errors[kind].items():
            figures[f"{metric}/{model}"] = float(np.median(values))
            figures[f"{metric.replace('rmse', 'rmse_mean')}/{model}"] = float(np.mean(values))
    progress.advance()
    for place, hung in (("standing", False), ("hung", True)):
        found = robot_fidelity(motors, models, hung, seed)
        for model in found.rmse:
            figures[f"{place}_rmse/{model}"] = float(np.median(found.rmse[model]))
            figures[f"{place}_torque_hf/{model}"] = _finite(np.median(found.torque_hf[model]))
            if not hung:
                figures[f"standing_displacement_error/{model}"] = _finite(np.median(found.displacement_error[model]))
        progress.advance()
    return figures


def _finite(value: Any) -> float:
    """Infinity (the simulation broke down) as the largest number JSON can hold."""
    return float(min(value, np.finfo(np.float64).max))


def _write_traces(
    path: Path, motors: MotorParameters, models: dict[str, ModelOfMotors], priors: dict[str, MotorPrior], seed: int
) -> None:
    """What the report draws: one bench trial, one robot trial, one torque fit."""
    index = np.arange(len(motors))
    case = held_out_trials("impacts", len(motors), seed)[0]
    truth = run(PhysicalActuator(motors), case)
    tensors = {
        "bench/target": case.position_target[:, 0],
        "bench/external": case.external_torque[:, 0],
        "bench/truth": truth.joint_pos[:, 0],
        "bench/torque": truth.joint_torque[:, 0],
    }
    for name, model in models.items():
        tensors[f"bench/model/{name}"] = run(model(index), case).joint_pos[:, 0]
    for name, prior in priors.items():
        tensors |= _torque_traces(name, prior, motors, seed)
    tensors |= _robot_traces(motors, models, seed)
    header = {"bench_dt": case.dt, "robot_dt": spec.CONTROL_DT, "joint": "FR_knee"}
    write_tensors(path, tensors, header)


def _torque_traces(name: str, prior: MotorPrior, motors: MotorParameters, seed: int) -> dict[str, np.ndarray]:
    """The prior shown the true history of a sinusoid, at its own period."""
    case = held_out_trials("sine", len(motors), seed)[1]
    skip = round(prior.network.period / case.dt)
    answer = run(PhysicalActuator(motors), case)
    sparse = type(case)(
        case.position_target[::skip], case.external_torque[::skip], case.load_inertia, prior.network.period
    )
    seen = type(answer)(*(getattr(answer, field)[::skip] for field in ("joint_pos", "joint_vel", "joint_torque")))
    predicted = teacher_forced_torque(prior.network, prior.mean, sparse, seen)[:, 0]
    known = ~np.isnan(predicted)
    time = np.arange(len(predicted)) * prior.network.period
    return {
        f"torque/{name}/time": time[known],
        f"torque/{name}/measured": seen.joint_torque[known, 0],
        f"torque/{name}/predicted": predicted[known],
    }


def _robot_traces(motors: MotorParameters, models: dict[str, ModelOfMotors], seed: int) -> dict[str, np.ndarray]:
    """The right front knee in a standing trot, positions [rad] and torques [N·m] at 2 ms."""
    index, targets = np.arange(spec.NUM_JOINTS), trot_targets(np.random.default_rng([seed, 1]), 100)
    knee, coarse = spec.JOINT_NAMES.index("FR_knee"), World(WorldConfig())
    fine = World(WorldConfig(physics_dt=spec.TWIN_PHYSICS_DT))
    every = round(spec.PHYSICS_DT / spec.TWIN_PHYSICS_DT)
    truth = replay(fine, PhysicalActuator(motors.take(index)), targets)
    tensors = {
        "robot/target": np.repeat(targets[:, knee], coarse.config.substeps),
        "robot/position/truth": truth.joint_pos[every - 1 :: every, knee],
        "robot/torque/truth": truth.joint_torque[every - 1 :: every, knee],
    }
    for name, model in models.items():
        played = replay(coarse, model(index), targets, tolerate_fault=True)
        tensors[f"robot/position/{name}"] = played.joint_pos[:, knee]
        tensors[f"robot/torque/{name}"] = played.joint_torque[:, knee]
    return {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in tensors.items()}


def show_fidelity(figures: dict[str, float]) -> None:
    """The first two tables, medians, on the terminal."""
    models = [name.split("/")[1] for name in figures if name.startswith("bench_impact_rmse/")]
    order = ["ideal_pd", "tuned_pd", "one_network", "paper", "rollout", "physical"]
    models = sorted(models, key=lambda name: order.index(name) if name in order else len(order))
    shown = [[name, *(f"{figures[f'{column}/{name}']:.4f}" for column in COLUMNS)] for name in models]
    titles = [column.replace("_rmse", "").replace("_torque_hf", " hf").replace("_", " ") for column in COLUMNS]
    title = "Closed-loop joint RMSE [rad] and torque above 20 Hz (hf) [N·m], medians; physical is the floor"
    table(title, ["model", *titles], shown)
