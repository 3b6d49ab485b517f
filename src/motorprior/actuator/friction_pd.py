"""The ideal PD with Coulomb friction at the joint: what simulators for legged robots commonly fit to a motor.

    torque = that of `ideal_pd` - clip(slope·joint_vel, ±coulomb)
    slope  = min(coulomb / SLOWEST, armature / physics_dt)

Below SLOWEST friction falls with speed, so that it is a force and no constraint of the engine; the second bound keeps
it from turning a bare rotor round within a step. A joint at rest therefore creeps where a real one sticks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.ideal_pd import IDEAL_PD_ROWS, IdealPd, reset_pd, step_pd
from motorprior.actuator.kind import ActuatorKind
from motorprior.compiled import njit

SLOWEST = 0.1
"""Speed [rad/s] above which friction is whole."""
_COULOMB, _SLOPE = IDEAL_PD_ROWS, IDEAL_PD_ROWS + 1


@dataclass(frozen=True)
class FrictionPd:
    """n motors with a proportional-derivative law and Coulomb friction.

    Attributes:
        pd: the law, with armature; without it there is no friction.
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
        slope = np.minimum(self.coulomb / SLOWEST, self.armature / physics_dt)
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
    """Write (n,) torque for the engine [N·m]."""
    step_pd(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    for motor in range(torque.shape[0]):
        coulomb = arrays.parameters[_COULOMB, motor]
        torque[motor] -= min(coulomb, max(-coulomb, arrays.parameters[_SLOPE, motor] * joint_vel[motor]))


FRICTION_PD = ActuatorKind("pd_friction", "PD with friction", "#8a8f3c", reset=reset_pd, step=_step)
