"""Settings of the commands deploy and record, and a check of the libraries for a serial port."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from motorprior.exceptions import ConfigError


def require_robot_extra() -> None:
    """Raise ConfigError if pyserial or msgpack is not installed."""
    missing = [
        name
        for name, module in (("pyserial", "serial"), ("msgpack", "msgpack"))
        if find_spec(module) is None
    ]
    if missing:
        raise ConfigError(
            f"{' and '.join(missing)} not installed", remedy="pip install 'motorprior[robot]'"
        )


@dataclass(frozen=True)
class RunSettings:
    """A run of a robot.

    Attributes:
        out: folder for run.csv (measurements, and the target in force; for `motorprior logs
            import`), run.json (settings, gains, limits, outcome) and figures.json (timing);
            runs/deploy/<date> or runs/record/<date> if not given.
        kp: position gain to send [A/rad]; the robot's own if not given.
        kd: velocity gain to send [A·s/rad]; the robot's own if not given.
        max_current: current limit to send [A]; the robot's own if not given.
        without_imu: run a robot whose IMU is not read: a fall is not detected.
        yes: arm without asking.
    """

    out: Path | None = None
    kp: float | None = None
    kd: float | None = None
    max_current: float | None = None
    without_imu: bool = False
    yes: bool = False


@dataclass(frozen=True)
class DeploySettings(RunSettings):
    """How to walk.

    Attributes:
        seconds: time to walk [s]; until it is stopped if not given.
        forward: initial speed [m/s]. If not given, a robot with keyboard or gamepad stands at
            first, and one without walks at 0.3 m/s.
        yaw_rate: initial turn to the left [rad/s].
        dry_run: compute everything and send nothing, for ``seconds`` or 5 s.
    """

    seconds: float | None = None
    forward: float | None = None
    yaw_rate: float = 0.0
    dry_run: bool = False


@dataclass(frozen=True)
class RecordSettings(RunSettings):
    """How to excite and record.

    Attributes:
        excitation: name of a signal, or a file of `motorprior excite`. sine, chirp, steps,
            multisine, gait and creep are a signal per joint, trot is one of the whole robot, varied
            is a multisine of all joints and then steps of one after the other; if not given, varied
            in the air and multisine standing.
        joint: joints to excite: all, a leg (FR), a kind (knee) or a joint (FR_knee).
        seconds: duration [s].
        amplitude: maximum distance from the nominal pose [rad]; 0.4 in the air and 0.1 standing if
            not given.
        max_speed: limit of the targets [rad/s]; if not given, 40 for steps and varied in the air,
            as in a walk, and 8 otherwise.
        standing: the robot stands on the ground and sits down afterwards; otherwise it is suspended
            in the air.
        seed: seed of the random signals.
    """

    excitation: str | None = None
    joint: str = "all"
    seconds: float = 60.0
    amplitude: float | None = None
    max_speed: float | None = None
    standing: bool = False
    seed: int = 0
