"""Step motors from Python: the compiled actuators, one physics step at a time, for a simulator of your own."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.bounds import require_finite


class Motors:
    """n motors with their state.

    A step gives a torque and a damping, for the simulator to integrate implicitly: with inertia J, step h and
    everything else that acts on the joint, τ_other, its new velocity dq' solves

        (J + armature)·(dq' - dq)/h = torque - damping·dq' + τ_other,

    that is dq' = (dq + h·(torque + τ_other)/(J + armature)) / (1 + h·damping/(J + armature)). The motor's whole effort
    is torque - damping·dq'. A stiff gear or a strong kd on a light link is stable this way, and chatters if its damping
    is put into the torque. Engines have both numbers: MuJoCo's ``dof_armature`` and ``dof_damping``.

    Args:
        actuator: n motors, for example of `MotorPrior.sample`.
        dt: physics step [s].
        joint_pos: (n,) initial angles, at rest [rad].
        position_target: (n,) targets before the first step [rad]; ``joint_pos`` if not given.

    Raises:
        ConfigError: a step that these cannot be simulated at, or arrays that do not fit.
    """

    def __init__(self, actuator: Actuator, dt: float, joint_pos: np.ndarray, position_target: np.ndarray | None = None):
        self._shape, self._dt = (actuator.num_motors,), dt
        self._arrays, self._armature = actuator.arrays(dt), np.array(actuator.armature)
        self.reset(joint_pos, position_target)

    def reset(self, joint_pos: np.ndarray, position_target: np.ndarray | None = None) -> None:
        """Begin again with rotors at rest at ``joint_pos`` (n,) [rad]; arguments as in the class."""
        start = require_finite("joint_pos", joint_pos, self._shape)
        before = start if position_target is None else require_finite("position_target", position_target, self._shape)
        reset_actuator(self._arrays, before, start)

    @property
    def armature(self) -> np.ndarray:
        """(n,) inertia that the simulator adds to the joints' own [kg·m²]."""
        return self._armature.copy()

    def step(
        self, position_target: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque [N·m] and damping [N·m·s/rad], each (n,), for the physics step that begins now; see the class.

        All arguments are (n,), [rad] and [rad/s]; raises `ConfigError` for another shape or what is not finite.
        """
        target = require_finite("position_target", position_target, self._shape)
        pos = require_finite("joint_pos", joint_pos, self._shape)
        vel = require_finite("joint_vel", joint_vel, self._shape)
        torque = np.zeros(self._shape)
        step_actuator(self._arrays, self._dt, target, pos, vel, torque)
        return torque, self._arrays.damping.copy()

    def encoder_pos(self, joint_pos: np.ndarray) -> np.ndarray:
        """(n,) angles [rad] that the motors' own encoders read, on the rotor where a motor has one there."""
        reading = np.zeros(self._shape)
        measure_joint_pos(self._arrays, require_finite("joint_pos", joint_pos, self._shape), reading)
        return reading
