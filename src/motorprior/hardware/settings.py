"""Settings of every run of a robot, and of a walk."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from motorprior.exceptions import ConfigError


def require_robot_extra() -> None:
    """Raise ConfigError if pyserial or msgpack is not installed."""
    modules = {"pyserial": "serial", "msgpack": "msgpack"}
    missing = [package for package, module in modules.items() if find_spec(module) is None]
    if missing:
        raise ConfigError(
            f"{' and '.join(missing)} not installed", remedy=f"pip install {' '.join(missing)}"
        )


@dataclass(frozen=True)
class RunSettings:
    """Settings of every run of a robot."""

    out: Path | None = None
    """Folder for run.csv (measurements, and the target in force; `motorprior logs import` reads
    it), run.json (settings, gains, limits, outcome) and figures.json (timing); runs/deploy/<date>
    or runs/record/<date> if not given."""
    kp: float | None = None
    """Position gain to send [A/rad]; the robot's own if not given."""
    kd: float | None = None
    """Velocity gain to send [A·s/rad]; the robot's own if not given."""
    max_current: float | None = None
    """Current limit to send [A]; the robot's own if not given."""
    without_imu: bool = False
    """Run a robot whose firmware does not read the IMU: falls are not detected."""
    yes: bool = False
    """Arm without asking."""


@dataclass(frozen=True)
class DeploySettings(RunSettings):
    """Settings of a walk."""

    seconds: float | None = None
    """Duration of the walk [s]; if not given, the robot walks until it is stopped."""
    forward: float | None = None
    """Initial speed [m/s]. If not given, a robot that is steered by keyboard or gamepad stands at
    first, and a robot without them walks at 0.3 m/s."""
    yaw_rate: float = 0.0
    """Initial turn to the left [rad/s]."""
    dry_run: bool = False
    """Compute the walk from telemetry and send nothing to the robot, for --seconds or 5 s."""
