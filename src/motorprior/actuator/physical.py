"""The physical motor with firmware, rotor, friction and gear: the ground truth of virtual benches and robots.

All quantities are at the output shaft. Per substep h (<= 0.25 ms), with the joint moving at constant velocity:

    encoder   θ = rotor_pos + encoder_zero            (on the rotor, so it does not measure backlash)
    filter    v += (1 - exp(-h / velocity_filter))·(rotor_vel - v)
    law       τ_law = clip(kp·(position_target(t - delay) - θ) - kd·v, ±torque_limit)
    speed     |τ_law| <= stall_torque·(1 - rotor_vel / no_load_speed) in the driving direction
    gear      p = deadzone(rotor_pos - joint_pos, backlash / 2)
              τ_gear = gear_stiffness·p + gear_damping·(rotor_vel - joint_vel) in contact, never pulling
    friction  F = coulomb + stribeck_torque·exp(-(rotor_vel / stribeck_velocity)²) + load_friction·|τ_gear|
    rotor     armature·d(rotor_vel)/dt = τ_law - τ_gear - viscous_damping·rotor_vel - F·sign

Dry friction is an impulse that can stop the rotor but never reverse it (exact stiction). The joint gets the mean of
τ_gear over the substeps. The structure follows puppersim's motor model (jietan/puppersim), with rotor, backlash and
delay added.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, Factors, empty_arrays, require_step
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, row_of_age, write_line

SUBSTEP = 0.00025  # maximum substep [s]: a tenth of the period of the fastest gear oscillation
MAX_STEP = 0.001  # maximum physics step [s] at which gear and bare shank, coupled once per step, are stable

(
    _KP, _KD, _DELAY, _FILTER, _TORQUE_LIMIT, _STALL_TORQUE, _NO_LOAD_SPEED, _ARMATURE, _COULOMB,
    _STRIBECK_TORQUE, _STRIBECK_VELOCITY, _VISCOUS, _LOAD_FRICTION, _BACKLASH, _STIFFNESS, _GEAR_DAMPING, _ZERO,
) = range(17)  # fmt: skip
ROTOR_POS, ROTOR_VEL, FILTERED_VEL, _LINE = range(4)  # rows of the memory; the delay line follows


@dataclass(frozen=True)
class MotorParameters:
    """n physical motors; every field has shape (n,)."""

    kp: np.ndarray  # [N·m/rad]
    kd: np.ndarray  # [N·m·s/rad]
    delay: np.ndarray  # command latency [s]
    velocity_filter: np.ndarray  # time constant [s]
    torque_limit: np.ndarray  # current limit times torque constant [N·m]
    stall_torque: np.ndarray  # voltage-limited torque at zero speed [N·m]
    no_load_speed: np.ndarray  # [rad/s]
    armature: np.ndarray  # rotor inertia reflected to the output [kg·m²]
    coulomb: np.ndarray  # [N·m]
    stribeck_torque: np.ndarray  # static friction above Coulomb's [N·m]
    stribeck_velocity: np.ndarray  # [rad/s]
    viscous_damping: np.ndarray  # [N·m·s/rad]
    load_friction: np.ndarray  # friction per transmitted torque [-]
    backlash: np.ndarray  # full play [rad]
    gear_stiffness: np.ndarray  # [N·m/rad]
    gear_damping: np.ndarray  # [N·m·s/rad]
    encoder_zero: np.ndarray  # encoder reading at true zero [rad]

    def __len__(self) -> int:
        """Number of motors."""
        return len(self.kp)

    def take(self, index: np.ndarray) -> MotorParameters:
        """The motors at ``index``."""
        return MotorParameters(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    def actuator(self) -> PhysicalActuator:
        """The same motors as an `Actuator`."""
        return PhysicalActuator(self)

    def after(self, seconds: float) -> MotorParameters:
        """The motors after ``seconds`` [s] of operation: unchanged."""
        return self

    def logged(
        self, rng: np.random.Generator, period: float, joint_pos: np.ndarray, joint_vel: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Recorded (steps, n) angles [rad], velocities [rad/s] and torques [N·m]: the true values, without noise."""
        return joint_pos, joint_vel, torque


@dataclass(frozen=True)
class PhysicalActuator(Actuator):
    """n physical motors. The model simulates the rotor, so the engine gets no armature and no damping."""

    motors: MotorParameters

    @property
    def kind(self) -> ActuatorKind:
        """PHYSICAL."""
        return PHYSICAL

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.motors)

    def with_factors(self, factors: Factors) -> PhysicalActuator:
        """See `actuator.with_factors`."""
        return PhysicalActuator(scaled(self.motors, factors._asdict() | {"stribeck_torque": factors.coulomb}))

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        require_step(physics_dt, MAX_STEP)
        table = np.stack([getattr(self.motors, field.name) for field in fields(self.motors)])
        ring = int(np.ceil(table[_DELAY].max() / physics_dt)) + 2
        table[_DELAY] /= physics_dt
        substeps = max(1, int(np.ceil(physics_dt / SUBSTEP - 1e-9)))
        table[_FILTER] = 1.0 - np.exp(-physics_dt / substeps / table[_FILTER])
        return empty_arrays(PHYSICAL, table, _LINE + ring, substeps)


def scaled(motors: Any, factors: Mapping[str, Any]) -> Any:
    """Motors with constants multiplied by factors [-]; ``motors`` is a dataclass with one field (n,) per constant."""
    return replace(motors, **{name: getattr(motors, name) * factor for name, factor in factors.items()})


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Static rotor at the angle of the joint, centred in the backlash."""
    arrays.memory[ROTOR_POS, :] = joint_pos
    arrays.memory[ROTOR_VEL, :] = 0.0
    arrays.memory[FILTERED_VEL, :] = 0.0
    fill_line(arrays.memory, _LINE, position_target)


@njit(cache=True, nogil=True)
def _control_torque(p: np.ndarray, motor: int, error: float, filtered: float, rotor_vel: float) -> float:
    limit = p[_TORQUE_LIMIT, motor]
    torque = min(limit, max(-limit, p[_KP, motor] * error - p[_KD, motor] * filtered))
    slope = p[_STALL_TORQUE, motor] / p[_NO_LOAD_SPEED, motor]
    upper = max(0.0, p[_STALL_TORQUE, motor] - slope * rotor_vel)
    lower = min(0.0, -p[_STALL_TORQUE, motor] - slope * rotor_vel)
    return min(upper, max(lower, torque))


@njit(cache=True, nogil=True)
def _gear_torque(p: np.ndarray, motor: int, twist: float, twist_vel: float) -> float:
    half = 0.5 * p[_BACKLASH, motor]
    if twist > half:
        return max(0.0, p[_STIFFNESS, motor] * (twist - half) + p[_GEAR_DAMPING, motor] * twist_vel)
    if twist < -half:
        return min(0.0, p[_STIFFNESS, motor] * (twist + half) + p[_GEAR_DAMPING, motor] * twist_vel)
    return 0.0


@njit(cache=True, nogil=True)
def _apply_friction(p: np.ndarray, motor: int, free_vel: float, rotor_vel: float, gear: float, h: float) -> float:
    ratio = rotor_vel / p[_STRIBECK_VELOCITY, motor]
    friction = p[_COULOMB, motor] + p[_LOAD_FRICTION, motor] * abs(gear)
    friction += p[_STRIBECK_TORQUE, motor] * math.exp(-ratio * ratio)
    remaining = max(0.0, abs(free_vel) - h / p[_ARMATURE, motor] * friction)
    return math.copysign(remaining, free_vel)


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    p, memory = arrays.parameters, arrays.memory
    now, substeps = arrays.clock[0], arrays.clock[1]
    newest, h = write_line(memory, _LINE, now, position_target), physics_dt / substeps
    for motor in range(torque.shape[0]):
        rotor_pos, rotor_vel = memory[ROTOR_POS, motor], memory[ROTOR_VEL, motor]
        filtered, q, dq, total = memory[FILTERED_VEL, motor], joint_pos[motor], joint_vel[motor], 0.0
        for k in range(substeps):
            age = max(0, math.ceil(p[_DELAY, motor] - k / substeps - 1e-9))
            target = memory[row_of_age(memory, _LINE, newest, age), motor]
            filtered += p[_FILTER, motor] * (rotor_vel - filtered)
            law = _control_torque(p, motor, target - rotor_pos - p[_ZERO, motor], filtered, rotor_vel)
            gear = _gear_torque(p, motor, rotor_pos - q, rotor_vel - dq)
            force = law - gear - p[_VISCOUS, motor] * rotor_vel
            rotor_vel = _apply_friction(p, motor, rotor_vel + h / p[_ARMATURE, motor] * force, rotor_vel, gear, h)
            rotor_pos += h * rotor_vel
            q += h * dq
            total += gear
        memory[ROTOR_POS, motor], memory[ROTOR_VEL, motor] = rotor_pos, rotor_vel
        memory[FILTERED_VEL, motor] = filtered
        torque[motor] = total / substeps


@njit(cache=True, nogil=True)
def _measure(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    for motor in range(out.shape[0]):
        out[motor] = arrays.memory[ROTOR_POS, motor] + arrays.parameters[_ZERO, motor]


PHYSICAL = ActuatorKind(
    "physical", "physical", reset=_reset, step=_step, measure=_measure, max_step=MAX_STEP, bench_step=SUBSTEP
)
