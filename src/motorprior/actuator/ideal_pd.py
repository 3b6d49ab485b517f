"""The ideal PD, optionally with armature and a delayed target.

    motor torque = clip(kp·(position_target(t - delay) - joint_pos) - kd·joint_vel, ±torque_limit)

kd acts on the absolute velocity, as in the firmware of hobby robots. The engine gets damping = kd, which it integrates
implicitly, and torque = motor torque + kd·joint_vel. Explicit damping of this size makes a light joint chatter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.actuator import (
    ActuatorArrays,
    Factors,
    empty_arrays,
    require_step,
    require_unchanged,
)
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line

if TYPE_CHECKING:
    from motorprior.robots.robot import Robot

_KP, KD, _DELAY, _TORQUE_LIMIT = range(4)
IDEAL_PD_ROWS = 4


@dataclass(frozen=True)
class IdealPd:
    """n motors with a proportional-derivative law; every field has shape (n,)."""

    kp: np.ndarray  # [N·m/rad]
    kd: np.ndarray  # [N·m·s/rad]
    torque_limit: np.ndarray  # [N·m]
    armature: np.ndarray  # [kg·m²]
    delay: np.ndarray  # command latency [s]

    @classmethod
    def uniform(
        cls, num_motors: int, kp: float, kd: float, torque_limit: float, armature: float = 0.0, delay: float = 0.0
    ) -> IdealPd:
        """The same constants for every motor."""
        return cls(*(np.full(num_motors, float(value)) for value in (kp, kd, torque_limit, armature, delay)))

    @property
    def kind(self) -> ActuatorKind:
        """IDEAL_PD."""
        return IDEAL_PD

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.kp)

    @property
    def damping(self) -> np.ndarray:
        """(n,) kd [N·m·s/rad]."""
        return self.kd

    def with_factors(self, factors: Factors) -> IdealPd:
        """See `actuator.with_factors`."""
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
    """PD motors fitted to a log with logged gains; their gains scale with the logged gains."""

    pd: IdealPd  # at the median logged gains
    logged: np.ndarray  # (2,) median logged kp and kd, in the unit of the log

    def at(self, gains: np.ndarray) -> IdealPd:
        """The motors (M,) at logged gains (2, M).

            kp' = kp·gains[0] / logged[0],   kd' = kd·gains[1] / logged[1]

        A gain with median 0 does not change.
        """
        middle = self.logged[:, None]
        kp, kd = np.where(middle > 0.0, gains / np.where(middle > 0.0, middle, 1.0), 1.0)
        return replace(self.pd, kp=self.pd.kp * kp, kd=self.pd.kd * kd)


@njit(cache=True, nogil=True)
def reset_pd(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the delay line with the current target."""
    fill_line(arrays.memory, 0, position_target)


@njit(cache=True, nogil=True)
def step_pd(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    """Write (n,) torque for the engine [N·m]; the delayed target is interpolated linearly between steps."""
    newest = write_line(arrays.memory, 0, arrays.clock[0], position_target)
    for motor in range(torque.shape[0]):
        target = interpolated(arrays.memory, 0, newest, arrays.parameters[_DELAY, motor], motor)
        limit = arrays.parameters[_TORQUE_LIMIT, motor]
        damping = arrays.parameters[KD, motor] * joint_vel[motor]
        raw = arrays.parameters[_KP, motor] * (target - joint_pos[motor]) - damping
        torque[motor] = min(limit, max(-limit, raw)) + damping


IDEAL_PD = ActuatorKind("ideal_pd", "ideal PD", reset=reset_pd, step=step_pd)


def described_pd(robot: Robot) -> IdealPd:
    """An ideal PD with the gains and torque limits of the robot's description."""
    columns = [np.array([getattr(joint, name) for joint in robot.joints]) for name in ("kp", "kd", "torque_limit")]
    kp, kd, torque_limit = columns
    return IdealPd(kp, kd, torque_limit, armature=np.zeros(robot.num_joints), delay=np.zeros(robot.num_joints))
