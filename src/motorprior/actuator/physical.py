"""The physical motor with firmware, rotor, friction and gear: truth of virtual benches and robots.

All quantities are at the output shaft. Per substep h (<= 0.25 ms), with the joint moving at
constant velocity:

    encoder   θ = rotor_pos + encoder_zero  (on the rotor, so it does not measure backlash)
    filter    v += (1 - exp(-h / velocity_filter))·(rotor_vel - v)
    control   τ_law = clip(kp·(position_target(t - delay) - θ) - kd·v, ±torque_limit)
              in MIT mode with + kd·velocity_target + torque_feedforward, and the gains in force
    speed     |τ_law| <= stall_torque·(1 - rotor_vel / no_load_speed) in the driving direction
    gear      p = deadzone(rotor_pos - joint_pos, backlash / 2)
              τ_gear = gear_stiffness·p + gear_damping·(rotor_vel - joint_vel) in contact,
              never pulling
    friction  F = coulomb + stribeck_torque·exp(-(rotor_vel / stribeck_velocity)²)
                  + load_friction·|τ_gear|
    rotor     armature·d(rotor_vel)/dt = τ_law - τ_gear - viscous_damping·rotor_vel - F·sign

Dry friction is an impulse that can stop the rotor but never reverse it (exact stiction). The joint
gets the mean of τ_gear over the substeps. The structure follows puppersim's motor model
(jietan/puppersim), with rotor, backlash and delay added.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from motorprior.actuator.actuator import ConstantFactors, empty_arrays, require_step
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.command_frame import (
    FEEDFORWARD,
    KD_FACTOR,
    KP_FACTOR,
    LINE,
    SENT,
    VELOCITY_TARGET,
    held_quantity,
)
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, held, write_line

SUBSTEP = 0.00025  # maximum substep [s]: a tenth of the period of the fastest gear oscillation
# maximum physics step [s] at which gear and bare shank, coupled once per step, are stable
MAX_STEP = 0.001

(
    _KP, _KD, _DELAY, _FILTER, _TORQUE_LIMIT, _STALL_TORQUE, _NO_LOAD_SPEED, _ARMATURE, _COULOMB,
    _STRIBECK_TORQUE, _STRIBECK_VELOCITY, _VISCOUS, _LOAD_FRICTION, _BACKLASH, _STIFFNESS,
    _GEAR_DAMPING, _ZERO,
) = range(17)  # fmt: skip
ROTOR_POS, ROTOR_VEL, FILTERED_VEL, _LINE = range(4)  # rows of the memory; the delay line follows


class TrueMotors(ABC):
    """n physical motors: base of dataclasses with parameters (n,), annotated with their units.

    The unit of a ratio is "1".
    """

    kind: ClassVar[ActuatorKind]  # name, title and compiled functions of the family
    # parameter -> field of `ConstantFactors` that scales it
    factor_names: ClassVar[Mapping[str, str]]
    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    armature: np.ndarray
    gear_stiffness: np.ndarray
    gear_damping: np.ndarray
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __len__(self) -> int:
        """Number of motors."""
        return len(self.kp)

    @abstractmethod
    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; see `Actuator.arrays`."""

    def take(self, index: np.ndarray) -> Self:
        """The motors at ``index``."""
        taken = {field.name: getattr(self, field.name)[index] for field in fields(self)}
        return replace(self, **taken)

    def scaled(self, factors: Mapping[str, Any]) -> Self:
        """The motors with parameters multiplied by factors [-]."""
        scaled = {name: getattr(self, name) * factor for name, factor in factors.items()}
        return replace(self, **scaled)

    def actuator(self) -> "PhysicalActuator":
        """The same motors as an `Actuator`."""
        return PhysicalActuator(self)

    def after(self, seconds: float) -> Self:
        """The motors after ``seconds`` [s] of operation: unchanged."""
        return self

    def logged(
        self,
        rng: np.random.Generator,
        period: float,
        joint_pos: np.ndarray,
        joint_vel: np.ndarray,
        torque: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Recorded (steps, n) angles [rad], velocities [rad/s] and torques [N·m]: without noise."""
        return joint_pos, joint_vel, torque


@dataclass(frozen=True)
class PhysicalActuator:
    """n physical motors. The model simulates the rotor, so the engine gets no armature."""

    motors: TrueMotors

    @property
    def kind(self) -> ActuatorKind:
        """The kind of the family."""
        return self.motors.kind

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.motors)

    @property
    def armature(self) -> np.ndarray:
        """(n,) zero [kg·m²]: the model simulates the rotor."""
        return np.zeros(self.num_motors)

    @property
    def damping(self) -> np.ndarray:
        """(n,) damping of the output shaft [N·m·s/rad]; 0 for families without it.

        The damping of the rotor is part of the model.
        """
        return getattr(self.motors, "output_damping", np.zeros(self.num_motors))

    def with_factors(self, factors: ConstantFactors) -> "PhysicalActuator":
        """The same motors with scaled constants; see `Actuator.with_factors`."""
        scales = {
            name: getattr(factors, factor) for name, factor in self.motors.factor_names.items()
        }
        return PhysicalActuator(self.motors.scaled(scales))

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; see `Actuator.arrays`."""
        return self.motors.arrays(physics_dt)


@njit(cache=True, nogil=True, inline="always")
def stribeck_share(speed: float, stribeck_velocity: float) -> float:
    """Share exp(-(speed/stribeck_velocity)²) of the static friction torque."""
    ratio = speed / stribeck_velocity
    return math.exp(-ratio * ratio)


@njit(cache=True, nogil=True, inline="always")
def voltage_limited(torque: float, limit: float, back: float) -> float:
    """The torque within the voltage limit [N·m].

    The limit is ``limit`` at zero speed, reduced by ``back`` of the back-EMF.
    """
    return min(max(0.0, limit - back), max(min(0.0, -limit - back), torque))


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Static rotor at the angle of the joint, centred in the backlash."""
    arrays.memory[ROTOR_POS, :] = joint_pos
    arrays.memory[ROTOR_VEL, :] = 0.0
    arrays.memory[FILTERED_VEL, :] = 0.0
    fill_line(arrays.memory, _LINE, position_target)


@njit(cache=True, nogil=True)
def _law_torque(
    arrays: ActuatorArrays, motor: int, error: float, filtered: float, newest: int, age: float
) -> float:
    """Torque of the control law without its limits, with the command of ``age`` steps ago."""
    kp = arrays.parameters[_KP, motor]
    kd = arrays.parameters[_KD, motor]
    frames = arrays.frames
    if frames.shape[0] == 0:
        return kp * error - kd * filtered

    n = arrays.damping.shape[0]
    kp *= held_quantity(frames, newest, age, KP_FACTOR, motor, n)
    kd *= held_quantity(frames, newest, age, KD_FACTOR, motor, n)
    velocity_target = held_quantity(frames, newest, age, VELOCITY_TARGET, motor, n)
    feedforward = held_quantity(frames, newest, age, FEEDFORWARD, motor, n)
    return kp * error - kd * filtered + (kd * velocity_target + feedforward)


@njit(cache=True, nogil=True)
def _control_torque(p: np.ndarray, motor: int, law_torque: float, rotor_vel: float) -> float:
    limit = p[_TORQUE_LIMIT, motor]
    torque = min(limit, max(-limit, law_torque))
    slope = p[_STALL_TORQUE, motor] / p[_NO_LOAD_SPEED, motor]
    return voltage_limited(torque, p[_STALL_TORQUE, motor], slope * rotor_vel)


@njit(cache=True, nogil=True)
def _gear_torque(p: np.ndarray, motor: int, twist: float, twist_vel: float) -> float:
    half = 0.5 * p[_BACKLASH, motor]
    if twist > half:
        return max(0.0, p[_STIFFNESS, motor] * (twist - half) + p[_GEAR_DAMPING, motor] * twist_vel)
    if twist < -half:
        return min(0.0, p[_STIFFNESS, motor] * (twist + half) + p[_GEAR_DAMPING, motor] * twist_vel)
    return 0.0


@njit(cache=True, nogil=True)
def _apply_friction(
    p: np.ndarray, motor: int, free_vel: float, rotor_vel: float, gear: float, h: float
) -> float:
    friction = p[_COULOMB, motor] + p[_LOAD_FRICTION, motor] * abs(gear)
    friction += p[_STRIBECK_TORQUE, motor] * stribeck_share(rotor_vel, p[_STRIBECK_VELOCITY, motor])
    remaining = max(0.0, abs(free_vel) - h / p[_ARMATURE, motor] * friction)
    return math.copysign(remaining, free_vel)


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    p = arrays.parameters
    memory = arrays.memory
    now = arrays.clock[0]
    substeps = arrays.clock[1]
    newest = write_line(memory, _LINE, now, position_target)
    newest_frame = 0
    if arrays.frames.shape[0] > 0:
        newest_frame = write_line(arrays.frames, LINE, now, arrays.frames[SENT])
    h = physics_dt / substeps
    for motor in range(torque.shape[0]):
        rotor_pos = memory[ROTOR_POS, motor]
        rotor_vel = memory[ROTOR_VEL, motor]
        filtered = memory[FILTERED_VEL, motor]
        q = joint_pos[motor]
        dq = joint_vel[motor]
        total = 0.0
        for k in range(substeps):
            age = p[_DELAY, motor] - k / substeps
            target = held(memory, _LINE, newest, age, motor)
            filtered += p[_FILTER, motor] * (rotor_vel - filtered)
            error = target - rotor_pos - p[_ZERO, motor]
            law_torque = _law_torque(arrays, motor, error, filtered, newest_frame, age)
            law = _control_torque(p, motor, law_torque, rotor_vel)
            gear = _gear_torque(p, motor, rotor_pos - q, rotor_vel - dq)

            force = law - gear - p[_VISCOUS, motor] * rotor_vel
            rotor_vel = _apply_friction(
                p, motor, rotor_vel + h / p[_ARMATURE, motor] * force, rotor_vel, gear, h
            )

            rotor_pos += h * rotor_vel
            q += h * dq
            total += gear

        memory[ROTOR_POS, motor] = rotor_pos
        memory[ROTOR_VEL, motor] = rotor_vel
        memory[FILTERED_VEL, motor] = filtered
        torque[motor] = total / substeps


@njit(cache=True, nogil=True)
def _read_encoders(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    for motor in range(out.shape[0]):
        out[motor] = arrays.memory[ROTOR_POS, motor] + arrays.parameters[_ZERO, motor]


PHYSICAL = ActuatorKind(
    "physical",
    "physical",
    reset=_reset,
    step=_step,
    read_encoders=_read_encoders,
    takes_frames=True,
    max_step=MAX_STEP,
    bench_step=SUBSTEP,
)


@dataclass(frozen=True)
class PhysicalMotors(TrueMotors):
    """n physical motors; every field has shape (n,)."""

    kind = PHYSICAL
    factor_names = {name: name for name in ConstantFactors._fields} | {"stribeck_torque": "coulomb"}

    kp: Annotated[np.ndarray, "N·m/rad"]
    kd: Annotated[np.ndarray, "N·m·s/rad"]
    delay: Annotated[np.ndarray, "s"]  # command latency
    velocity_filter: Annotated[np.ndarray, "s"]  # time constant
    torque_limit: Annotated[np.ndarray, "N·m"]  # current limit times torque constant
    stall_torque: Annotated[np.ndarray, "N·m"]  # voltage-limited torque at zero speed
    no_load_speed: Annotated[np.ndarray, "rad/s"]
    armature: Annotated[np.ndarray, "kg·m²"]  # rotor inertia reflected to the output
    coulomb: Annotated[np.ndarray, "N·m"]
    stribeck_torque: Annotated[np.ndarray, "N·m"]  # static friction above Coulomb's
    stribeck_velocity: Annotated[np.ndarray, "rad/s"]
    viscous_damping: Annotated[np.ndarray, "N·m·s/rad"]
    load_friction: Annotated[np.ndarray, "1"]  # friction per transmitted torque
    backlash: Annotated[np.ndarray, "rad"]  # full play
    gear_stiffness: Annotated[np.ndarray, "N·m/rad"]
    gear_damping: Annotated[np.ndarray, "N·m·s/rad"]
    encoder_zero: Annotated[np.ndarray, "rad"]  # encoder reading at true zero

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; see `Actuator.arrays`."""
        require_step(physics_dt, MAX_STEP)
        table = np.stack([getattr(self, field.name) for field in fields(self)])
        ring = int(np.ceil(table[_DELAY].max() / physics_dt)) + 2
        table[_DELAY] /= physics_dt
        substeps = max(1, int(np.ceil(physics_dt / SUBSTEP - 1e-9)))
        table[_FILTER] = 1.0 - np.exp(-physics_dt / substeps / table[_FILTER])
        return empty_arrays(PHYSICAL, table, _LINE + ring, substeps)
