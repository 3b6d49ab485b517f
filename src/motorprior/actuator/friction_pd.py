"""The ideal PD with Coulomb friction at the joint: what simulators for legged robots commonly fit to a motor.

    torque = that of `ideal_pd` - clip(coulomb/SLOWEST·joint_vel, ±coulomb)

Below SLOWEST friction falls with speed, so that it is a force and no constraint of the engine: a joint at rest creeps
where a real one sticks. A force so steep would turn a light joint round within a physics step. While

    |joint_vel| < coulomb/slope,   slope = min(coulomb/SLOWEST, armature/physics_dt + kd),

it is therefore damping, coulomb/max(|joint_vel|, SLOWEST), that the engine takes implicitly. An engine that cannot
renew its damping gets clip(slope·joint_vel, ±coulomb), which on a light rotor is whole only at a higher speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.ideal_pd import IDEAL_PD_ROWS, KD, IdealPd, reset_pd, step_pd
from motorprior.actuator.kind import ActuatorKind
from motorprior.compiled import njit

SLOWEST = 0.1
"""Speed [rad/s] above which friction is whole."""
_COULOMB, _SLOPE = IDEAL_PD_ROWS, IDEAL_PD_ROWS + 1


@dataclass(frozen=True)
class FrictionPd:
    """n motors with a proportional-derivative law and Coulomb friction.

    Attributes:
        pd: the law.
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

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        law = self.pd.arrays(physics_dt)
        slope = np.minimum(self.coulomb / SLOWEST, self.armature / physics_dt + self.damping)
        return law._replace(law=FRICTION_PD.law, parameters=np.vstack([law.parameters, self.coulomb, slope]))


@njit(cache=True, nogil=True)
def _step(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque for the engine [N·m] and ``arrays.damping``."""
    step_pd(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    for motor in range(torque.shape[0]):
        speed, coulomb = abs(joint_vel[motor]), arrays.parameters[_COULOMB, motor]
        arrays.damping[motor] = arrays.parameters[KD, motor]
        if arrays.parameters[_SLOPE, motor] * speed < coulomb:
            arrays.damping[motor] += coulomb / max(speed, SLOWEST)
        else:
            torque[motor] -= math.copysign(coulomb, joint_vel[motor])


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Take the friction that is damping as a force, at most as steep as keeps a bare rotor from turning round."""
    for motor in range(torque.shape[0]):
        renewed = arrays.damping[motor] - arrays.parameters[KD, motor]
        torque[motor] -= min(renewed, arrays.parameters[_SLOPE, motor]) * joint_vel[motor]
        arrays.damping[motor] = arrays.parameters[KD, motor]


FRICTION_PD = ActuatorKind(
    "pd_friction", "PD with friction", "#8a8f3c", reset=reset_pd, step=_step, make_explicit=_make_explicit
)
