"""Learn an excitation from runs of a robot."""

from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from motorprior.artifacts import atomic_path
from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.excitation.fit_excitation import STEPS, fit_excitation
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.logs.load_log import load_log
from motorprior.logs.loads import with_torque_balance
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot

_CONTROL_PERIOD = 0.01  # [s], without a robot


@dataclass(frozen=True)
class Excite:
    """Learn an excitation that looks like runs of a robot."""

    runs: tuple[Path, ...]
    """Logs in any format of docs/logs.md: recordings of `deploy` and `record`, logs of `simulate`,
    imported logs."""
    out: Path
    """File to write (.safetensors)."""
    method: str = "generated"
    """generated (adversarial network), surrogate (Gaussian process with the runs' spectrum and
    marginals) or recorded (windows of the runs)."""
    robot: str | None = None
    """Robot of the runs: name of a shipped robot, or a .toml file. Its model gives the loads of
    runs with torques, and the bounds of the excitation."""
    columns: str | None = None
    """Column map of tables, as in `logs import`."""
    period: float | None = None
    """Control period of the runs [s]. If not given: the robot's control period, or 0.01 without a
    robot."""
    suspended: bool = False
    """The robot was suspended or has a fixed base, so that its model gives the loads."""
    commands: tuple[float, ...] = ()
    """Commanded speed of each run [m/s], if known."""
    max_speed: float = inf
    """Bound of the targets' speed [rad/s]; 1.25 times the maximum of the runs if not given. The
    robot's own limit holds as well."""
    max_torque: float = inf
    """Bound of the external torques for a bench [N·m]; 1.25 times the maximum of the runs if not
    given."""
    steps: int = STEPS
    """Training steps of the network."""
    csv_seconds: float = 0.0
    """Duration of an example for every joint class, targets and external torques, that is also
    written as .csv [s]; no example if 0."""
    seed: int = 0
    """Seed of the training and of the generated excitation."""


def run_excite(config: Excite, progress: Progress = SILENT) -> LearnedExcitation:
    """Fit and write; errors for a setting or file that cannot be used."""
    if config.out.suffix != ".safetensors":
        raise ConfigError(
            f"out {str(config.out)!r} is not a .safetensors file",
            remedy="name it so",
            argument="out",
        )
    require_number("csv_seconds", config.csv_seconds)

    robot = load_robot(config.robot) if config.robot else None
    logs = [_with_loads(config, robot, path, progress) for path in config.runs]
    excitation = fit_excitation(
        logs,
        config.method,
        period=_control_period(config, robot),
        commands=config.commands,
        max_speed=min(config.max_speed, _speed_limit(robot)),
        max_torque=config.max_torque,
        steps=config.steps,
        seed=config.seed,
        out=config.out,
        progress=progress,
    )

    for line in excitation.class_lines():
        progress.note(line)
    if config.csv_seconds:
        path = config.out.with_suffix(".csv")
        _write_csv(excitation, path, config.csv_seconds, config.seed)
    return excitation


def _with_loads(config: Excite, robot: Robot | None, path: Path, progress: Progress) -> MotorLog:
    log = load_log(
        path,
        columns=config.columns,
        robot=robot,
        suspended=config.suspended,
        progress=progress,
        allow_errors=True,  # they are printed as warnings
    )
    if log.external_torque is not None:
        return log
    if log.joint_torque is not None and robot is not None:
        return with_torque_balance(log, robot)
    progress.note(f"{path}: no loads; only position targets are learned from it")
    return log


def _control_period(config: Excite, robot: Robot | None) -> float:
    if config.period is not None:
        return config.period
    return _CONTROL_PERIOD if robot is None else robot.control_dt


def _speed_limit(robot: Robot | None) -> float:
    """The robot's own limit of targets [rad/s]."""
    if robot is None or robot.wire is None:
        return inf
    return robot.wire.safety.target_speed


def _write_csv(excitation: LearnedExcitation, path: Path, seconds: float, seed: int) -> None:
    """Write a table with a row per control period.

    Columns for each class: position_target [rad], external_torque [N·m] (the mean of the period),
    and load_inertia [kg·m²] where the runs have loads.
    """
    period = excitation.period
    rng = np.random.default_rng(seed)
    streams = excitation.streams(rng, round(seconds / period), period, excitation.classes)

    columns = [period * np.arange(len(streams.position_target))]
    names = ["time"]
    for channel, values in streams._asdict().items():
        if values is None:
            continue
        columns.append(np.broadcast_to(values, streams.position_target.shape))
        names += [f"{channel}/{joint_class}" for joint_class in excitation.classes]

    with atomic_path(path) as temporary:
        table = np.column_stack(columns)
        np.savetxt(temporary, table, "%.6g", ",", header=",".join(names), comments="")
