"""Learn an excitation from runs of a robot, and plan what to play next."""

from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import atomic_path
from motorprior.bench.excitation import Streams
from motorprior.bench.learned_excitation import LearnedExcitation
from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.excitation.fit_excitation import STEPS, fit_excitation, windows_of
from motorprior.excitation.plan import check_plan, plan_excitation
from motorprior.logs.load_log import load_log
from motorprior.logs.loads import with_torque_balance
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot


@dataclass(frozen=True)
class Excite:
    """Learn an excitation that looks like runs of a robot."""

    runs: tuple[Path, ...]
    """Logs in any format of docs/logs.md: recordings of `deploy` and `record`, logs of `simulate`, imported logs."""
    out: Path
    """File to write (.safetensors); a plan is written next to it."""
    method: str = "generated"
    """generated (adversarial network), surrogate (Gaussian process with the runs' spectrum and marginals) or recorded
    (windows of the runs)."""
    robot: str | None = None
    """Robot of the runs: a shipped one by name, or a .toml file; gives the loads of runs with torques, and bounds."""
    columns: str | None = None
    """Column map of tables, as in `logs import`."""
    period: float | None = None
    """Control period of the runs [s]; that of the robot, or 0.01 without one, if not given."""
    suspended: bool = False
    """The robot was suspended or has a fixed base: compute the loads from its model."""
    commands: tuple[float, ...] = ()
    """Commanded speed of each run [m/s], if known."""
    max_speed: float = inf
    """Bound of the targets' speed [rad/s]; 1.25 times the runs' if not given. The robot's own limit holds as well."""
    max_torque: float = inf
    """Bound of external torques [N·m], for a bench; 1.25 times the runs' if not given."""
    steps: int = STEPS
    """Training steps of the network."""
    plan_prior: Path | None = None
    """Prior (.safetensors): also write the windows that shrink its posterior most, as OUT with .plan.safetensors, and
    report what they identify."""
    csv_seconds: float = 0.0
    """Duration of targets and external torques of every joint class that are also written as .csv [s]."""
    seed: int = 0
    """Seed of the training and the streams."""


def run_excite(config: Excite, progress: Progress = SILENT) -> LearnedExcitation:
    """Fit, plan, write; the plan's excitation if there is one. Errors for a setting or file that cannot be used."""
    if config.out.suffix != ".safetensors":
        raise ConfigError(
            f"out {str(config.out)!r} is not a .safetensors file",
            remedy="name it so",
            argument="out",
        )
    require_number("csv_seconds", config.csv_seconds)
    robot = load_robot(config.robot) if config.robot else None
    logs = [_with_loads(config, robot, path, progress) for path in config.runs]
    period = (robot.control_dt if robot else 0.01) if config.period is None else config.period
    speed = robot.wire.safety.target_speed if robot and robot.wire else inf
    prior = None if config.plan_prior is None else MotorPrior.load(config.plan_prior)
    if prior is not None:  # before the training
        check_plan(windows_of(logs, period, config.commands), prior)
    found = fit_excitation(
        logs,
        config.method,
        period=period,
        commands=config.commands,
        max_speed=min(config.max_speed, speed),
        max_torque=config.max_torque,
        steps=config.steps,
        seed=config.seed,
        out=config.out,
        progress=progress,
    )
    out = config.out
    if prior is not None:
        found, plans = plan_excitation(found, prior, config.seed)
        out = out.with_suffix(".plan.safetensors")
        found.save(out)
        for plan in plans:
            progress.note(str(plan))
        progress.note(
            f"the windows to play are in {out}, {sum(plan.seconds for plan in plans):.1f} s"
        )
    for line in found.class_lines():
        progress.note(line)
    if config.csv_seconds:
        _write_csv(found, out.with_suffix(".csv"), config.csv_seconds, config.seed)
    return found


def _with_loads(config: Excite, robot: Robot | None, path: Path, progress: Progress) -> MotorLog:
    log = load_log(
        path, columns=config.columns, robot=robot, suspended=config.suspended, progress=progress
    )
    if log.external_torque is not None:
        return log
    if log.joint_torque is not None and robot is not None:
        return with_torque_balance(log, robot)
    progress.note(f"{path}: no loads; only position targets are learned from it")
    return log


def _write_csv(found: LearnedExcitation, path: Path, seconds: float, seed: int) -> None:
    """Per class position_target [rad], external_torque [N·m], mean of a control period, and load_inertia [kg·m²]."""
    streams = found.streams(
        np.random.default_rng(seed), round(seconds / found.period), found.period, found.classes
    )
    known = [
        np.broadcast_to(each, streams.position_target.shape) for each in streams if each is not None
    ]
    names = [
        f"{channel}/{name}" for channel in Streams._fields[: len(known)] for name in found.classes
    ]
    time = found.period * np.arange(len(streams.position_target))
    with atomic_path(path) as temporary:
        table = np.column_stack([time, *known])
        np.savetxt(temporary, table, "%.6g", ",", header=",".join(["time", *names]), comments="")
