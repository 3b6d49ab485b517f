"""The PD of legged-robot simulators, ideal or with armature, delayed target and Coulomb friction.

    motor torque = clip(kp·(position_target(t - delay) - joint_pos) - kd·joint_vel, ±torque_limit)
                   - clip(coulomb/FULL_FRICTION_SPEED·joint_vel, ±coulomb)

kd acts on the absolute velocity, as in the firmware of hobby robots. In MIT mode, the control law
also has kd·velocity_target + torque_feedforward, and the gains in force. The engine gets damping =
kd, which it integrates implicitly, and torque = motor torque + kd·joint_vel. Explicit damping of
this size makes a light joint chatter.

Friction is a force, not a constraint of the engine. Below FULL_FRICTION_SPEED it is proportional to
the speed, so a static joint creeps where a real one sticks. Such a steep explicit force could
reverse a light joint within a step h. Friction is therefore explicit only if it cannot reverse even
the bare rotor,

    |v| >= FULL_FRICTION_SPEED  and  armature·|v| + h·(torque·sign(v) - coulomb) > 0.

Otherwise it is a damping coulomb/w, which the engine integrates implicitly:

    w = |v|                               from FULL_FRICTION_SPEED,
    w = max(FULL_FRICTION_SPEED, reached) below it

where ``reached`` is the speed of the bare rotor after the step:

    reached = (|armature·v + h·torque| - h·coulomb) / (armature + h·kd)

Friction is wrong for one step when a heavy load starts or a bare rotor reverses. An engine with
constant damping gets a friction of at most armature/h·v, which equals coulomb at the speed
coulomb·h/armature.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.actuator import (
    ConstantFactors,
    empty_arrays,
    require_step,
    require_unchanged,
)
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.command_frame import (
    FEEDFORWARD,
    IN_FORCE,
    KD_FACTOR,
    KP_FACTOR,
    VELOCITY_TARGET,
    delay_frames,
    mean_target,
)
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line

if TYPE_CHECKING:
    from motorprior.robots.robot import Robot

FULL_FRICTION_SPEED = 0.1  # speed [rad/s] from which friction equals coulomb
# the last three with friction only
_KP, KD, _DELAY, _TORQUE_LIMIT, _COULOMB, _ARMATURE, _MAX_SLOPE = range(7)
_TINY = 1e-12  # replaces zero armature [kg·m²]


@dataclass(frozen=True)
class IdealPd:
    """n motors with a proportional-derivative control law; every field has shape (n,)."""

    kp: np.ndarray  # [N·m/rad]
    kd: np.ndarray  # [N·m·s/rad]
    torque_limit: np.ndarray  # [N·m]
    armature: np.ndarray  # [kg·m²]; without it friction is too small
    delay: np.ndarray  # command latency [s]
    coulomb: np.ndarray  # friction [N·m]

    @classmethod
    def without_friction(
        cls,
        kp: np.ndarray,
        kd: np.ndarray,
        torque_limit: np.ndarray,
        armature: np.ndarray,
        delay: np.ndarray,
    ) -> "IdealPd":
        """Motors with these constants and no friction."""
        return cls(kp, kd, torque_limit, armature, delay, coulomb=np.zeros(len(kp)))

    @classmethod
    def uniform(
        cls,
        num_motors: int,
        kp: float,
        kd: float,
        torque_limit: float,
        armature: float = 0.0,
        delay: float = 0.0,
        coulomb: float = 0.0,
    ) -> "IdealPd":
        """The same constants for every motor."""
        values = (kp, kd, torque_limit, armature, delay, coulomb)
        return cls(*(np.full(num_motors, float(value)) for value in values))

    @property
    def kind(self) -> ActuatorKind:
        """The kind of PD: ideal, or with friction if any motor has some."""
        return FRICTION_PD if self.coulomb.any() else IDEAL_PD

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.kp)

    @property
    def damping(self) -> np.ndarray:
        """(n,) kd [N·m·s/rad]."""
        return self.kd

    def with_factors(self, factors: ConstantFactors) -> "IdealPd":
        """The same motors with scaled constants; see `Actuator.with_factors`."""
        if self.kind is IDEAL_PD:
            require_unchanged(self.kind, factors, "coulomb")
        scaled = {name: getattr(self, name) * factor for name, factor in factors._asdict().items()}
        return replace(self, **scaled)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; see `Actuator.arrays`."""
        require_step(physics_dt)
        ring = int(np.ceil(self.delay.max() / physics_dt)) + 2
        rows = [self.kp, self.kd, self.delay / physics_dt, self.torque_limit]
        if self.kind is FRICTION_PD:
            rows += [self.coulomb, self.armature, self.armature / physics_dt]
        return empty_arrays(self.kind, np.stack(rows), ring, 1, self.kd)


@dataclass(frozen=True)
class GainScaledPd:
    """PD motors fitted to a log with logged gains; their gains scale with the logged gains."""

    pd: IdealPd  # PD at the median logged gains
    logged: np.ndarray  # (2,) median logged kp and kd, in the unit of the log

    def at(self, gains: np.ndarray) -> IdealPd:
        """The motors (M,) at logged gains (2, M).

            kp' = kp·gains[0] / logged[0],   kd' = kd·gains[1] / logged[1]

        A gain with median 0 does not change.
        """
        median = self.logged[:, None]
        is_scaled = median > 0.0
        kp_factor, kd_factor = np.where(is_scaled, gains / np.where(is_scaled, median, 1.0), 1.0)
        return replace(self.pd, kp=self.pd.kp * kp_factor, kd=self.pd.kd * kd_factor)


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the delay line with the current target."""
    fill_line(arrays.memory, 0, position_target)


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    """Write the torque for the engine; the delayed target is interpolated between steps."""
    newest = write_line(arrays.memory, 0, arrays.clock[0], position_target)
    frames = arrays.frames
    if frames.shape[0] > 0:
        delay_frames(frames, arrays.clock[0], arrays.parameters[_DELAY], 0.0)
    n = torque.shape[0]
    for motor in range(n):
        target = interpolated(arrays.memory, 0, newest, arrays.parameters[_DELAY, motor], motor)
        limit = arrays.parameters[_TORQUE_LIMIT, motor]
        kp = arrays.parameters[_KP, motor]
        kd = arrays.parameters[KD, motor]
        feedforward = 0.0
        if frames.shape[0] > 0:
            age = arrays.parameters[_DELAY, motor]
            target = mean_target(arrays.memory, 0, frames, arrays.clock[0], age, motor, KP_FACTOR)
            kp *= frames[IN_FORCE, KP_FACTOR * n + motor]
            kd *= frames[IN_FORCE, KD_FACTOR * n + motor]
            feedforward = kd * frames[IN_FORCE, VELOCITY_TARGET * n + motor]
            feedforward += frames[IN_FORCE, FEEDFORWARD * n + motor]
            arrays.damping[motor] = kd
        damping = kd * joint_vel[motor]
        raw = kp * (target - joint_pos[motor]) - damping + feedforward
        torque[motor] = min(limit, max(-limit, raw)) + damping


@njit(cache=True, nogil=True, inline="always")
def _kd_in_force(arrays: ActuatorArrays, motor: int) -> float:
    kd = arrays.parameters[KD, motor]
    if arrays.frames.shape[0] > 0:
        kd *= arrays.frames[IN_FORCE, KD_FACTOR * arrays.damping.shape[0] + motor]
    return kd


@njit(cache=True, nogil=True)
def _step_with_friction(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    for motor in range(torque.shape[0]):
        kd = _kd_in_force(arrays, motor)
        coulomb = arrays.parameters[_COULOMB, motor]
        armature = arrays.parameters[_ARMATURE, motor]
        velocity = joint_vel[motor]
        speed = abs(velocity)
        impulse = physics_dt * torque[motor]
        friction = physics_dt * coulomb
        moves = speed >= FULL_FRICTION_SPEED

        # explicit friction
        arrays.damping[motor] = kd
        if moves and armature * speed + math.copysign(impulse, impulse * velocity) > friction:
            torque[motor] -= math.copysign(coulomb, velocity)
            continue

        # friction as damping
        if not moves:
            inertia = max(armature + physics_dt * kd, _TINY)
            reached = (abs(armature * velocity + impulse) - friction) / inertia
            speed = max(FULL_FRICTION_SPEED, reached)
        arrays.damping[motor] += coulomb / speed


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Apply the friction in the damping as a force, too small to reverse a rotor without kd."""
    for motor in range(torque.shape[0]):
        kd = _kd_in_force(arrays, motor)
        friction = arrays.damping[motor] - kd
        torque[motor] -= min(friction, arrays.parameters[_MAX_SLOPE, motor]) * joint_vel[motor]
        arrays.damping[motor] = kd


IDEAL_PD = ActuatorKind("ideal_pd", "ideal PD", reset=_reset, step=_step, takes_frames=True)
FRICTION_PD = ActuatorKind(
    "friction_pd",
    "PD with friction",
    reset=_reset,
    step=_step_with_friction,
    make_explicit=_make_explicit,
    takes_frames=True,
)


def described_pd(robot: "Robot") -> IdealPd:
    """An ideal PD with the gains and torque limits of the robot's description.

    Raises ConfigError if the description has no gains.
    """
    kp, kd = robot.require_gains()
    return IdealPd.without_friction(
        kp=kp,
        kd=kd,
        torque_limit=np.array([joint.torque_limit for joint in robot.joints]),
        armature=np.zeros(robot.num_joints),
        delay=np.zeros(robot.num_joints),
    )
