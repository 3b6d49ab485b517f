"""The ideal PD with Coulomb friction at the joint: what simulators for legged robots commonly fit to a motor.

    torque = that of `ideal_pd` - clip(coulomb/SLOWEST·joint_vel, ±coulomb)

Below SLOWEST friction falls with speed, so that it is a force and no constraint of the engine: a joint at rest creeps
where a real one sticks. So steep a force would turn a light joint round within a step h. Friction is therefore a force
only where not even the bare rotor, the lightest load there is, would turn round,

    |v| >= SLOWEST  and  armature·|v| + h·(torque·sign(v) - coulomb) > 0,

and else damping coulomb/w, which the engine takes implicitly: of a moving joint w = |v|, of one slower than SLOWEST the
speed that the bare rotor reaches within the step, (|armature·v + h·torque| - h·coulomb) / (armature + h·kd), or SLOWEST
if that is more. So a heavy load that starts, or a bare rotor that turns round, meets too little or too much for a step.
An engine that cannot renew its damping gets at most armature/h·v instead: it is whole from coulomb·h/armature on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays, Factors
from motorprior.actuator.ideal_pd import IDEAL_PD_ROWS, KD, IdealPd, reset_pd, step_pd
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit

SLOWEST = 0.1  # Speed [rad/s] above which friction is whole
_COULOMB, _ARMATURE, _STEEPEST = range(IDEAL_PD_ROWS, IDEAL_PD_ROWS + 3)
_TINY = 1e-12  # Inertia of a rotor without any [kg·m²]


@dataclass(frozen=True)
class FrictionPd:
    """n motors with a proportional-derivative law and Coulomb friction.

    Attributes:
        pd: the law, with armature; without it friction is too little.
        coulomb: (n,) [N·m].
    """

    pd: IdealPd
    coulomb: np.ndarray

    @property
    def kind(self) -> ActuatorKind:
        """That of a PD with friction."""
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
        """(n,) kd, integrated implicitly by the engine [N·m·s/rad]."""
        return self.pd.damping

    def with_factors(self, factors: Factors) -> FrictionPd:
        """See `HasConstants`."""
        pd = self.pd.with_factors(factors._replace(coulomb=np.ones(self.num_motors)))
        return FrictionPd(pd, self.coulomb * factors.coulomb)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        arrays = self.pd.arrays(physics_dt)
        rows = [arrays.parameters, self.coulomb, self.armature, self.armature / physics_dt]
        return arrays._replace(kernels=FRICTION_PD.kernels, parameters=np.vstack(rows))


@njit(cache=True, nogil=True)
def _step(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    step_pd(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    for motor in range(torque.shape[0]):
        kd, coulomb = arrays.parameters[KD, motor], arrays.parameters[_COULOMB, motor]
        armature, velocity = arrays.parameters[_ARMATURE, motor], joint_vel[motor]
        speed, impulse, taken = abs(velocity), physics_dt * torque[motor], physics_dt * coulomb
        moves = speed >= SLOWEST
        arrays.damping[motor] = kd
        if moves and armature * speed + math.copysign(impulse, impulse * velocity) > taken:
            torque[motor] -= math.copysign(coulomb, velocity)
            continue
        if not moves:
            reached = (abs(armature * velocity + impulse) - taken) / max(armature + physics_dt * kd, _TINY)
            speed = max(SLOWEST, reached)
        arrays.damping[motor] += coulomb / speed


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Take the friction that is damping as a force, no steeper than keeps a rotor without kd from turning round."""
    for motor in range(torque.shape[0]):
        renewed = arrays.damping[motor] - arrays.parameters[KD, motor]
        torque[motor] -= min(renewed, arrays.parameters[_STEEPEST, motor]) * joint_vel[motor]
        arrays.damping[motor] = arrays.parameters[KD, motor]


FRICTION_PD = ActuatorKind("pd_friction", "PD with friction", reset=reset_pd, step=_step, make_explicit=_make_explicit)
