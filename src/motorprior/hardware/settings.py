"""Settings of a walk and of a recording of a robot."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import SafetyLimits

# default limits of the targets' speed [rad/s], see `RecordSettings.max_speed`
_FAST_TARGETS = 40.0
_SLOW_TARGETS = 8.0
# default amplitudes [rad]; small on the ground, where feet that push into it look blocked
_STANDING_AMPLITUDE = 0.1
_SUSPENDED_AMPLITUDE = 0.4


def require_robot_extra() -> None:
    """Raise ConfigError if pyserial or msgpack is not installed."""
    modules = {"pyserial": "serial", "msgpack": "msgpack"}
    missing = [package for package, module in modules.items() if find_spec(module) is None]
    if missing:
        raise ConfigError(
            f"{' and '.join(missing)} not installed", remedy="pip install 'motorprior[robot]'"
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


@dataclass(frozen=True)
class Playback:
    """How the targets of a recording are played.

    Attributes:
        excitation: name of a signal, or a file of `motorprior excite`.
        amplitude: maximum distance from the nominal pose [rad].
        max_speed: limit of the targets [rad/s].
    """

    excitation: str
    amplitude: float
    max_speed: float


@dataclass(frozen=True)
class RecordSettings(RunSettings):
    """Settings of an excitation and its recording."""

    excitation: str | None = None
    """Name of a signal, or a file of `motorprior excite`. The signals sine, chirp, steps,
    multisine, gait and creep excite every joint on its own; trot is a gait of the whole robot;
    varied is a multisine on all joints, then steps on one joint after the other. If not given:
    varied in the air, multisine for a standing robot."""
    joint: str = "all"
    """Joints to excite: all, a whole leg (FR), a joint of every leg (knee) or one joint
    (FR_knee)."""
    seconds: float = 60.0
    """Duration [s]."""
    amplitude: float | None = None
    """Maximum distance of the targets from the nominal pose [rad]. If not given: 0.4 in the air,
    0.1 for a standing robot."""
    max_speed: float | None = None
    """Limit of the targets' speed [rad/s]. If not given: 40, as in a walk, for the signals steps
    and varied in the air; 8 otherwise."""
    standing: bool = False
    """The robot stands on the ground and sits down afterwards; otherwise it is suspended in the
    air."""
    seed: int = 0
    """Seed of the random signals."""

    def playback(self, safety: SafetyLimits) -> Playback:
        """Excitation and limits, with the defaults of the posture.

        Raises ConfigError for a value out of range.
        """
        # steps of a leg that carries weight would tip a standing robot
        excitation = self.excitation or ("multisine" if self.standing else "varied")

        amplitude = self.amplitude
        if amplitude is None:
            amplitude = _STANDING_AMPLITUDE if self.standing else _SUSPENDED_AMPLITUDE

        max_speed = self.max_speed
        if max_speed is None:
            # steps in the air must be fast, to reach a motor's torque limit
            has_fast_steps = excitation in ("steps", "varied") and not self.standing
            usual_speed = _FAST_TARGETS if has_fast_steps else _SLOW_TARGETS
            max_speed = min(safety.target_speed, usual_speed)

        require_number("seconds", self.seconds, 1.0, 3600.0)
        require_number("amplitude", amplitude, 0.0, 1.5, positive=True)
        require_number("max_speed", max_speed, 0.0, safety.target_speed, positive=True)
        require_seed(self.seed)
        return Playback(excitation, amplitude, max_speed)
