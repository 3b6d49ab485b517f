"""Ideal PD with Coulomb friction at the joint, the motor model that legged-robot simulators commonly fit.

    torque = torque of `ideal_pd` - clip(coulomb/FULL_FRICTION_SPEED·joint_vel, ±coulomb)

Friction is a force, not a constraint of the engine: below FULL_FRICTION_SPEED it is proportional to the speed, so a
static joint creeps where a real one sticks. An explicit force this steep would reverse a light joint within a step h.
Friction is therefore explicit only where it cannot reverse even the bare rotor,

    |v| >= FULL_FRICTION_SPEED  and  armature·|v| + h·(torque·sign(v) - coulomb) > 0,

and otherwise a damping coulomb/w that the engine integrates implicitly. For a moving joint w = |v|. Below
FULL_FRICTION_SPEED, w is the speed that the bare rotor reaches within the step,
(|armature·v + h·torque| - h·coulomb) / (armature + h·kd), and at least FULL_FRICTION_SPEED. When a heavy load starts or
a bare rotor reverses, friction is wrong for one step. An engine with constant damping gets at most armature/h·v, which
reaches coulomb at the speed coulomb·h/armature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays, Factors
from motorprior.actuator.ideal_pd import IDEAL_PD_ROWS, KD, IdealPd, reset_pd, step_pd
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit

FULL_FRICTION_SPEED = 0.1  # speed [rad/s] from which friction equals coulomb
_COULOMB, _ARMATURE, _MAX_SLOPE = range(IDEAL_PD_ROWS, IDEAL_PD_ROWS + 3)
_TINY = 1e-12  # replaces zero armature [kg·m²]


@dataclass(frozen=True)
class FrictionPd:
    """n motors with a proportional-derivative law and Coulomb friction."""

    pd: IdealPd  # with armature: without it friction is too small
    coulomb: np.ndarray  # (n,) [N·m]

    @property
    def kind(self) -> ActuatorKind:
        """FRICTION_PD."""
        return FRICTION_PD

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return self.pd.num_motors

    @property
    def armature(self) -> np.ndarray:
        """(n,) [kg·m²]."""
        return self.pd.armature

    @property
    def damping(self) -> np.ndarray:
        """(n,) kd [N·m·s/rad]."""
        return self.pd.damping

    def with_factors(self, factors: Factors) -> FrictionPd:
        """See `actuator.with_factors`."""
        pd = self.pd.with_factors(factors._replace(coulomb=np.ones(self.num_motors)))
        return FrictionPd(pd, self.coulomb * factors.coulomb)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        arrays = self.pd.arrays(physics_dt)
        rows = [arrays.parameters, self.coulomb, self.armature, self.armature / physics_dt]
        return arrays._replace(kernels=FRICTION_PD.kernels, parameters=np.vstack(rows))


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    step_pd(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    for motor in range(torque.shape[0]):
        kd, coulomb = arrays.parameters[KD, motor], arrays.parameters[_COULOMB, motor]
        armature, velocity = arrays.parameters[_ARMATURE, motor], joint_vel[motor]
        speed, impulse, friction = abs(velocity), physics_dt * torque[motor], physics_dt * coulomb
        moves = speed >= FULL_FRICTION_SPEED
        arrays.damping[motor] = kd
        if moves and armature * speed + math.copysign(impulse, impulse * velocity) > friction:
            torque[motor] -= math.copysign(coulomb, velocity)
            continue
        if not moves:
            reached = (abs(armature * velocity + impulse) - friction) / max(armature + physics_dt * kd, _TINY)
            speed = max(FULL_FRICTION_SPEED, reached)
        arrays.damping[motor] += coulomb / speed


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Apply the friction part of the damping as a force, limited so that it cannot reverse a rotor without kd."""
    for motor in range(torque.shape[0]):
        friction = arrays.damping[motor] - arrays.parameters[KD, motor]
        torque[motor] -= min(friction, arrays.parameters[_MAX_SLOPE, motor]) * joint_vel[motor]
        arrays.damping[motor] = arrays.parameters[KD, motor]


FRICTION_PD = ActuatorKind("pd_friction", "PD with friction", reset=reset_pd, step=_step, make_explicit=_make_explicit)
