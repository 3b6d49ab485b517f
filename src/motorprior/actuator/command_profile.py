"""The trajectory profile of a servo, applied to its commands outside the motor."""

import math
from typing import NamedTuple

import numpy as np

from motorprior.actuator.geared_motor_step import Arithmetic
from motorprior.actuator.optional_terms import CONSTANTS, profiled
from motorprior.bounds import require_number

_MAX_STEP = 0.002  # a servo moves its reference at 500 Hz or more [s]
_ARITHMETIC = Arithmetic(
    where=np.where,
    indicator=lambda condition: 1.0 * condition,
    clip=lambda x, limit: np.clip(x, -limit, limit),
    positive_part=lambda x: np.maximum(x, 0.0),
    with_sign_of=lambda magnitude, other: np.sign(other) * magnitude,
    sqrt=np.sqrt,
)


class _Limits(NamedTuple):
    profile_speed: float
    profile_acceleration: float


class _State(NamedTuple):
    reference: np.ndarray
    reference_vel: np.ndarray


class CommandProfile:
    """Turns position targets into the references that a servo with a profile follows.

    For simulators and exports whose motors lack the profile: give them `step`'s result in place of
    the target. The formula is that of the term "profile" of `optional_terms`.

    Args:
        start: (n,) joint angles at the beginning [rad].
        dt: period of the commands [s].
        speed: limit [rad/s]; 0: none.
        acceleration: limit [rad/s²]; 0: none.

    Raises:
        ConfigError: a value out of range.
    """

    def __init__(
        self, start: np.ndarray, dt: float, *, speed: float = 0.0, acceleration: float = 0.0
    ):
        require_number("dt", dt, 0.0, 1.0, positive=True)
        require_number("speed", speed)
        require_number("acceleration", acceleration)
        # the values that disable the limits
        self._limits = _Limits(
            speed or CONSTANTS["profile_speed"].unlimited,
            acceleration or CONSTANTS["profile_acceleration"].unlimited,
        )
        self._substeps = math.ceil(dt / _MAX_STEP - 1e-9)
        self._h = dt / self._substeps
        reference = np.array(start, dtype=np.float64)
        self._state = _State(reference, np.zeros_like(reference))

    def step(self, position_target: np.ndarray) -> np.ndarray:
        """The (n,) references [rad] after a period in which (n,) targets [rad] were in force."""
        target = np.asarray(position_target, dtype=np.float64)
        for _ in range(self._substeps):
            self._state = profiled(self._limits, self._state, target, self._h, _ARITHMETIC)
        return self._state.reference.copy()
