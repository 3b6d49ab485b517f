"""Constants of foreign motors, and the motors as an `Actuator`; formulas and sources are in `foreign_step`."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from motorprior.actuator import foreign_step as rows
from motorprior.actuator.actuator import ActuatorArrays, Factors, empty_arrays, multiplied, require_step
from motorprior.actuator.foreign_step import FOREIGN
from motorprior.actuator.kind import ActuatorKind

_CRAWL = 1e-9  # Stribeck velocity of motors whose friction does not depend on speed [rad/s]


@dataclass(frozen=True)
class ForeignMotors:
    """n foreign motors; every field has shape (n,). "off at 0" is said of the first constant of a term."""

    kp: np.ndarray  # [N·m/rad]
    kd: np.ndarray  # [N·m·s/rad], off at 0
    torque_limit: np.ndarray  # current limit times torque constant of the cold motor [N·m]
    delay: np.ndarray  # command latency [s], off at 0
    servo_period: np.ndarray  # period of the firmware's law, whose output is held in between [s]; 0: every substep
    profile_speed: np.ndarray  # largest speed of the reference [rad/s]; 0: no bound
    profile_acceleration: np.ndarray  # largest acceleration of the reference [rad/s²]; 0: no bound
    dead_zone: np.ndarray  # error below which the law gives nothing [rad], off at 0
    ki: np.ndarray  # integral gain [N·m/(rad·s)], off at 0
    integral_limit: np.ndarray  # largest integral part of the torque [N·m]
    output_encoder: np.ndarray  # encoder: 0 on the rotor, 1 on the output shaft [-]
    encoder_quantum: np.ndarray  # step of the encoder's readings [rad], off at 0
    encoder_zero: np.ndarray  # encoder reading at true zero [rad]
    velocity_filter: np.ndarray  # time constant of the law's velocity [s], off at 0
    current_time: np.ndarray  # time constant of the current loop [s], off at 0
    stall_torque: np.ndarray  # voltage-limited torque at rest [N·m]; 0: no voltage limit
    no_load_speed: np.ndarray  # speed at which the voltage leaves no torque [rad/s]; 0: speed takes no voltage
    sag: np.ndarray  # share of the supply voltage lost at the stall current [-], off at 0
    heat_loss: np.ndarray  # share of the torque constant that a warm motor has lost [-], off at 0
    heat_time: np.ndarray  # time constant of the warming [s]; 0: the warmth stays as it is
    warmth: np.ndarray  # share of the final warming at the start [-]
    ripple: np.ndarray  # amplitude of the torque's ripple, share of the torque [-], off at 0
    # periods per turn of the output shaft: gear ratio times periods per turn of the rotor [1/rev]
    ripple_order: np.ndarray
    ripple_phase: np.ndarray  # [rad]
    cogging: np.ndarray  # amplitude of the torque without current [N·m], off at 0
    cogging_order: np.ndarray  # as ripple_order [1/rev]
    cogging_phase: np.ndarray  # [rad]
    armature: np.ndarray  # rotor inertia reflected to the output [kg·m²]
    viscous_damping: np.ndarray  # [N·m·s/rad], off at 0
    coulomb: np.ndarray  # sliding friction [N·m], off at 0
    static_torque: np.ndarray  # friction at rest above the sliding friction [N·m], off at 0
    stribeck_velocity: np.ndarray  # [rad/s]; 0: friction does not depend on speed, and bristles have no damping
    bristle_stiffness: np.ndarray  # stiffness of the friction before it slides [N·m/rad]; 0: no dry friction at all
    bristle_damping: np.ndarray  # damping of the friction before it slides [N·m·s/rad], off at 0
    load_friction: np.ndarray  # friction per torque in the gear [-], off at 0
    asymmetry: np.ndarray  # share by which friction is larger forwards, smaller backwards [-], off at 0
    position_friction: np.ndarray  # share by which friction varies with the position [-], off at 0
    position_order: np.ndarray  # as ripple_order [1/rev]
    position_phase: np.ndarray  # [rad]
    backlash: np.ndarray  # full play [rad], off at 0
    gear_stiffness: np.ndarray  # of the first contact, without the slider [N·m/rad]
    gear_hardening: np.ndarray  # cubic stiffness [N·m/rad³], off at 0
    gear_damping: np.ndarray  # [N·m·s/rad], off at 0
    slider_stiffness: np.ndarray  # stiffness of the spring behind the slider [N·m/rad], off at 0
    slider_torque: np.ndarray  # torque at which the slider slips [N·m], off at 0
    output_damping: np.ndarray  # viscous damping of the output shaft, seals and grease [N·m·s/rad], off at 0
    log_position_noise: np.ndarray  # standard deviation of the angles in a log [rad], off at 0
    log_position_quantum: np.ndarray  # step of the angles in a log [rad], off at 0
    # time constant of the differences of logged angles that a log has for velocities [s]; 0: the true
    # velocities
    log_velocity_filter: np.ndarray
    log_velocity_noise: np.ndarray  # standard deviation of the velocities in a log [rad/s], off at 0
    log_torque_noise: np.ndarray  # standard deviation of the torques in a log [N·m], off at 0

    def __len__(self) -> int:
        """Number of motors."""
        return len(self.kp)

    def take(self, index: np.ndarray) -> ForeignMotors:
        """The motors at ``index``."""
        return ForeignMotors(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    def table(self) -> np.ndarray:
        """(45, n) in the order of the fields, without the output shaft's and the log's."""
        return np.stack([getattr(self, name) for name in ForeignMotors.__dataclass_fields__][: rows.NUM_ROWS])

    def actuator(self) -> ForeignActuator:
        """See `TrueMotors.actuator`."""
        return ForeignActuator(self)

    def after(self, seconds: float) -> ForeignMotors:
        """The same motors, warmer: 1 - warmth falls by exp(-seconds / heat_time)."""
        return replace(self, warmth=self.warmth + (1.0 - self.warmth) * _share(seconds, self.heat_time, 0.0))

    def logged(
        self, rng: np.random.Generator, period: float, joint_pos: np.ndarray, joint_vel: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `TrueMotors.logged`: noise, the step of the readings, velocities from differences of the readings."""
        position, velocity, effort = rng.standard_normal((3, *joint_pos.shape))
        angle = joint_pos + self.log_position_noise * position
        step = np.where(self.log_position_quantum > 0.0, self.log_position_quantum, 1.0)
        angle = np.where(self.log_position_quantum > 0.0, step * np.round(angle / step), angle)
        differenced = _differenced(angle, period, _share(period, self.log_velocity_filter, 1.0))
        speed = np.where(self.log_velocity_filter > 0.0, differenced, joint_vel)
        return angle, speed + self.log_velocity_noise * velocity, torque + self.log_torque_noise * effort


@dataclass(frozen=True)
class ForeignActuator:
    """n foreign motors as an `Actuator`. Rotor inertia is inside the model, so the engine gets none."""

    motors: ForeignMotors

    @property
    def kind(self) -> ActuatorKind:
        """The foreign motor's."""
        return FOREIGN

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.motors)

    @property
    def armature(self) -> np.ndarray:
        """Zero: the rotor is simulated here."""
        return np.zeros(self.num_motors)

    @property
    def damping(self) -> np.ndarray:
        """The output shaft's; the rotor's is simulated here."""
        return self.motors.output_damping

    def with_factors(self, factors: Factors) -> ForeignActuator:
        """See `HasConstants`; the integral's gain follows kp, as that of the learned motors does."""
        return ForeignActuator(
            multiplied(self.motors, factors._asdict() | {"static_torque": factors.coulomb, "ki": factors.kp})
        )

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        require_step(physics_dt, rows.LONGEST_STEP)
        table = self.motors.table()
        substeps = max(1, int(np.ceil(physics_dt / rows.SUBSTEP - 1e-9)))
        h, line = physics_dt / substeps, int(np.ceil(table[rows.DELAY].max() / physics_dt)) + 2
        table[rows.DELAY] /= physics_dt
        table[rows.SERVO_PERIOD] = np.maximum(table[rows.SERVO_PERIOD], h)
        table[rows.VELOCITY_FILTER] = _share(table[rows.SERVO_PERIOD], table[rows.VELOCITY_FILTER], 1.0)
        table[rows.CURRENT_TIME] = _share(h, table[rows.CURRENT_TIME], 1.0)
        table[rows.HEAT_TIME] = _share(h, table[rows.HEAT_TIME], 0.0)
        table[rows.NO_LOAD_SPEED] = np.where(table[rows.NO_LOAD_SPEED] > 0.0, table[rows.NO_LOAD_SPEED], np.inf)
        table[rows.STRIBECK_VELOCITY] = np.maximum(table[rows.STRIBECK_VELOCITY], _CRAWL)
        return empty_arrays(FOREIGN, table, rows.LINE + line, substeps, self.damping)


def _share(seconds: np.ndarray | float, time_constant: np.ndarray, off: float) -> np.ndarray:
    """(n,) share of the way 1 - exp(-seconds / time_constant) [-]; ``off`` where the time constant is 0."""
    on = time_constant > 0.0
    return np.where(on, -np.expm1(-seconds / np.where(on, time_constant, 1.0)), off)


def _differenced(angle: np.ndarray, period: float, share: np.ndarray) -> np.ndarray:
    """(steps, n) low-passed differences [rad/s] of (steps, n) angles, from rest."""
    raw = np.diff(angle, axis=0, prepend=angle[:1]) / period
    filtered = np.zeros_like(raw)
    for step in range(1, len(raw)):
        filtered[step] = filtered[step - 1] + share * (raw[step] - filtered[step - 1])
    return filtered
