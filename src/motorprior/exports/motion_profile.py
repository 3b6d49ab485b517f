"""The motion profile of servos' firmware, for simulators whose actuators have none.

The profile limits speed and acceleration of the position target. Applied to the target before it
goes to an exported actuator, it gives the motors what their firmware gives them:

    profile = mp.MotionProfile.load("runs/mjcf/motors.json", dt=model.opt.timestep, start=start)
    data.ctrl[:] = profile.step(position_target)  # before every mj_step
"""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from motorprior.actuator.geared_motor_step import Arithmetic
from motorprior.actuator.optional_terms import profiled
from motorprior.artifacts import read_json
from motorprior.bounds import require_array
from motorprior.exceptions import ArtifactError, ConfigError

KEY = "motion_profile"  # in motors.json
SPEED = "profile_speed"
ACCELERATION = "profile_acceleration"
_NUMPY = Arithmetic(
    where=np.where,
    indicator=lambda condition: np.where(condition, 1.0, 0.0),
    clip=lambda value, limit: np.clip(value, -limit, limit),
    positive_part=lambda value: np.maximum(value, 0.0),
    with_sign_of=np.copysign,
    sqrt=np.sqrt,
)


@dataclass
class _State:
    """Reference of the profile."""

    reference: np.ndarray  # (J,) [rad]
    reference_vel: np.ndarray  # (J,) [rad/s]

    def _replace(self, reference: np.ndarray, reference_vel: np.ndarray) -> "_State":
        return _State(reference, reference_vel)


class MotionProfile:
    """References of J joints that follow position targets within limits.

    Args:
        speed: (J,) maximum speed [rad/s].
        acceleration: (J,) maximum acceleration [rad/s²].
        dt: step [s].
        start: (J,) angles at rest [rad].
    """

    def __init__(
        self, speed: np.ndarray, acceleration: np.ndarray, *, dt: float, start: np.ndarray
    ):
        speed = np.asarray(speed, float)
        self._limits = SimpleNamespace(
            profile_speed=speed, profile_acceleration=np.asarray(acceleration, float)
        )
        self._dt = dt
        self.reset(start)

    @classmethod
    def load(
        cls, path: str | Path, *, dt: float, start: np.ndarray, robot: int = 0
    ) -> "MotionProfile":
        """The profile of one sampled robot in a motors.json of `export`.

        Raises:
            ArtifactError: the motors have no profile, or the file is not of `export`.
            ConfigError: ``robot`` is not the number of a sample.
        """
        content = read_json(Path(path))
        if not isinstance(content, dict) or KEY not in content:
            remedy = "use the targets as they are, or export motors whose firmware has a profile"
            raise ArtifactError("its motors have no motion profile", where=path, remedy=remedy)
        count = len(content[KEY][SPEED])
        if not 0 <= robot < count:
            raise ConfigError(f"robot {robot} of {count}", remedy=f"give 0 to {count - 1}")
        limits = (content[KEY][name][robot] for name in (SPEED, ACCELERATION))
        return cls(*map(np.array, limits), dt=dt, start=start)

    def reset(self, start: np.ndarray) -> None:
        """Put the references to rest at angles (J,) [rad]."""
        shape = self._limits.profile_speed.shape
        start = require_array("start", start, shape)
        self._state = _State(start.copy(), np.zeros(shape))

    def step(self, position_target: np.ndarray) -> np.ndarray:
        """(J,) references [rad] of the coming step, for position targets (J,) [rad]."""
        target = require_array("position_target", position_target, self._state.reference.shape)
        self._state = profiled(self._limits, self._state, target, self._dt, _NUMPY)
        return self._state.reference.copy()
