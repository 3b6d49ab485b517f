"""The ideal PD, optionally with armature and a delayed target.

    motor torque = clip(kp·(position_target(t - delay) - joint_pos) - kd·joint_vel, ±torque_limit)

kd acts on the absolute velocity, as in the firmware of hobby robots. The engine gets damping = kd, which it
integrates implicitly, and torque = motor torque + kd·joint_vel, so that their sum is the law above: an
explicit kd of this size on a light joint chatters, and the baseline would be a straw man.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays, Factors, empty_arrays, require_step, require_unchanged
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line

_KP, KD, _DELAY, _TORQUE_LIMIT = range(4)
IDEAL_PD_ROWS = 4  # Of the parameters


@dataclass(frozen=True)
class IdealPd:
    """n motors with a proportional-derivative law.

    Attributes:
        kp: (n,) [N·m/rad].
        kd: (n,) [N·m·s/rad].
        torque_limit: (n,) bound of the motor torque [N·m].
        armature: (n,) [kg·m²].
        delay: (n,) age of the target acted on [s].
    """

    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    armature: np.ndarray
    delay: np.ndarray

    @classmethod
    def uniform(
        cls, num_motors: int, kp: float, kd: float, torque_limit: float, armature: float = 0.0, delay: float = 0.0
    ) -> IdealPd:
        """The same constants for every motor."""
        return cls(*(np.full(num_motors, float(value)) for value in (kp, kd, torque_limit, armature, delay)))

    @property
    def kind(self) -> ActuatorKind:
        """The ideal PD's."""
        return IDEAL_PD

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.kp)

    @property
    def damping(self) -> np.ndarray:
        """kd, integrated implicitly by the engine [N·m·s/rad]."""
        return self.kd

    def with_factors(self, factors: Factors) -> IdealPd:
        """See `with_factors`."""
        require_unchanged(self.kind, factors, "coulomb")
        limit = self.torque_limit * factors.torque_limit
        return replace(self, kp=self.kp * factors.kp, kd=self.kd * factors.kd, torque_limit=limit)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        require_step(physics_dt)
        ring = int(np.ceil(self.delay.max() / physics_dt)) + 2
        parameters = np.stack([self.kp, self.kd, self.delay / physics_dt, self.torque_limit])
        return empty_arrays(IDEAL_PD, parameters, ring, 1, self.kd)


@dataclass(frozen=True)
class GainScaledPd:
    """A PD that was fitted to a log which states gains; it follows the gains that another log states."""

    pd: IdealPd  # the motors at the median gains
    logged: np.ndarray  # (2,) medians of the logged kp and kd, in the log's unit

    def at(self, gains: np.ndarray) -> IdealPd:
        """The motors (M,) at logged gains (2, M).

            kp' = kp·gains[0] / logged[0],   kd' = kd·gains[1] / logged[1]

        Where the median is 0 that gain stays as it is.
        """
        middle = self.logged[:, None]
        kp, kd = np.where(middle > 0.0, gains / np.where(middle > 0.0, middle, 1.0), 1.0)
        return replace(self.pd, kp=self.pd.kp * kp, kd=self.pd.kd * kd)


@njit(cache=True, nogil=True)
def reset_pd(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the delay line with the present target."""
    fill_line(arrays.memory, 0, position_target)


@njit(cache=True, nogil=True)
def step_pd(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque for the engine [N·m]; a delay between two steps interpolates linearly between their targets."""
    newest = write_line(arrays.memory, 0, arrays.clock[0], position_target)
    for motor in range(torque.shape[0]):
        target = interpolated(arrays.memory, 0, newest, arrays.parameters[_DELAY, motor], motor)
        limit = arrays.parameters[_TORQUE_LIMIT, motor]
        damping = arrays.parameters[KD, motor] * joint_vel[motor]
        raw = arrays.parameters[_KP, motor] * (target - joint_pos[motor]) - damping
        torque[motor] = min(limit, max(-limit, raw)) + damping


IDEAL_PD = ActuatorKind("ideal_pd", "ideal PD", reset=reset_pd, step=step_pd)
