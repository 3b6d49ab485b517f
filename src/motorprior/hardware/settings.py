"""Settings of a robot's run, for every command line, and the libraries that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from motorprior.exceptions import ConfigError

Excitation = Literal["varied", "sine", "chirp", "steps", "multisine", "gait"]


def require_robot_extra() -> None:
    """Refuse to go on without the two libraries of the serial port and its messages.

    Raises:
        ConfigError: pyserial or msgpack is not installed.
    """
    missing = [name for name, module in (("pyserial", "serial"), ("msgpack", "msgpack")) if find_spec(module) is None]
    if missing:
        raise ConfigError(f"{' and '.join(missing)} not installed", remedy="pip install 'motorprior[robot]'")


@dataclass(frozen=True)
class DeploySettings:
    """How to walk.

    Attributes:
        out: folder for run.csv (measurements, and the target then in force), run.json (settings, gains, limits,
            outcome) and figures.json (how well the clock was kept); runs/deploy/<date> if not given.
        seconds: time to walk [s]; until it is stopped if not given.
        forward: speed to begin with [m/s]. If it is not given, a robot that somebody steers with keys or a gamepad
            stands until it is told to walk, and one that nobody steers walks at 0.3 m/s.
        yaw_rate: turn to the left to begin with [rad/s].
        kp: position gain to send [A/rad]; the robot's own if not given.
        kd: velocity gain to send [A·s/rad]; the robot's own if not given.
        max_current: current limit to send [A]; the robot's own if not given.
        longest_pause: the longest pause of this machine that the policy survives, to be ridden out [s]; after a longer
            one, of less than the watchdog's time, the robot sits down. The robot's own if not given.
        without_imu: walk a robot whose IMU is not read: a fall is not detected.
        dry_run: compute everything and send nothing, for ``seconds`` or 5 s.
        yes: arm without asking.
    """

    out: Path | None = None
    seconds: float | None = None
    forward: float | None = None
    yaw_rate: float = 0.0
    kp: float | None = None
    kd: float | None = None
    max_current: float | None = None
    longest_pause: float | None = None
    without_imu: bool = False
    dry_run: bool = False
    yes: bool = False


@dataclass(frozen=True)
class RecordSettings:
    """How to excite and record.

    Attributes:
        out: folder for run.csv, ready for `motorprior logs import`, run.json and figures.json; runs/record/<date> if
            not given.
        excitation: sine, chirp, steps and multisine are each joint's own signal, gait is a trot, varied is a multisine
            of all and then steps of one joint after the other; if not given, varied in the air and otherwise multisine.
        joint: all, a leg (FR), a kind (knee) or a joint (FR_knee).
        seconds: duration [s].
        amplitude: largest distance from the nominal pose [rad]; 0.4 in the air and 0.1 standing if not given.
        speed: fastest target [rad/s]; if not given, 40 for steps and varied in the air, as a walk has, and otherwise 8.
        standing: the robot stands on the ground and sits down afterwards; otherwise it hangs in the air.
        kp: position gain to send [A/rad]; the robot's own if not given.
        kd: velocity gain to send [A·s/rad]; the robot's own if not given.
        max_current: current limit to send [A]; the robot's own if not given.
        seed: of the random signals.
        without_imu: record a standing robot whose IMU is not read: a fall is not detected.
        yes: arm without asking.
    """

    out: Path | None = None
    excitation: Excitation | None = None
    joint: str = "all"
    seconds: float = 60.0
    amplitude: float | None = None
    speed: float | None = None
    standing: bool = False
    kp: float | None = None
    kd: float | None = None
    max_current: float | None = None
    seed: int = 0
    without_imu: bool = False
    yes: bool = False
