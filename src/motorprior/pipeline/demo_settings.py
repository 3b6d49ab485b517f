"""Settings of a demo, the robot that it walks on, and checks of the settings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from motorprior.bench.bench_folder import require_bench_size
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.quick_report.real_motors import RealMotors
from motorprior.pipeline.replay.replay import read_logs
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Demo:
    """A small run of everything, minutes on two cores. A rerun continues where the last one stopped."""

    out: Path = Path("runs/demo")
    """Run folder: all artefacts, figures.json and report.html."""
    fleet: str | None = None
    """Fleet of motors: a shipped one by name, or a .toml file; the robot's own if not given."""
    logs: Path | None = None
    """Folder with real logs, in any format of docs/logs.md: the demo begins with a comparison of their motors. Logs of
    the shipped robot are in jietan/puppersim, puppersim/data/system_id."""
    columns: str | None = None
    """Column map of tables among the logs: a shipped one by name, or your .toml file (docs/your-motors.md)."""
    suspended: bool = False
    """In the logs the robot is suspended with its body level, so that the loads of its motors are known."""
    seed: int = 0
    """Seed of everything."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor and preset."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    iterations: int = 50
    """ARS iterations per policy."""
    seeds: int = 2
    """Policies per condition."""
    workers: int = 2
    """Independent stages that run at the same time; the result does not depend on it."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). After the comparison of logs,
    the shipped one replaces a robot that cannot walk or has no fleet."""


def that_walks(config: Demo) -> Demo:
    """The settings; with logs, on the shipped robot if the given one cannot walk or has no fleet."""
    robot = load_robot(config.robot)
    walks = bool(robot.legs) and robot.base == "free" and (config.fleet is not None or bool(robot.fleets))
    return config if walks or config.logs is None else replace(config, robot=DEFAULT_ROBOT, fleet=None)


def comparison_of(config: Demo) -> RealMotors | None:
    """Settings of the comparison of real motors, if there are logs."""
    if config.logs is None:
        return None
    out = config.out / "real_motors"
    return RealMotors(config.logs, out, config.columns, config.suspended, config.seed, config.robot)


def require_settings(config: Demo, replayed: bool) -> None:
    """Check settings before anything is written.

    Raises:
        MotorPriorError: names the setting.
    """
    for name, is_given in {"suspended": config.suspended, "columns": config.columns is not None}.items():
        if is_given and config.logs is None:
            raise ConfigError(f"{name} is given without logs", remedy="give logs too, or omit it", argument=name)
    robot = load_robot(config.robot)
    robot.require_legs()
    require_count("motors", config.motors, robot.num_joints)
    require_bench_size(config.motors, config.bench_steps, "bench_steps")
    for name in ("iterations", "seeds"):
        require_count(name, getattr(config, name))
    require_count("workers", config.workers)
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    require_seed(config.seed)
    load_robot_fleet(robot, config.fleet)
    if replayed and config.logs is not None:
        read_logs(config.logs, robot)
