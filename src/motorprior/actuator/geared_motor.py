"""The physical half of the grey-box decoder: a latent z becomes the constants of a servo, rotor and gear.

    log θ = center + zᵀ·slope            θ: the 14 PARAMETERS, kept within e^±LOG_REACH of the centre;
                                         encoder_zero = ZERO_SCALE·(center + zᵀ·slope), which may be negative

All quantities at the output shaft. A step h takes positions from t to t + h and velocities from t - h/2 to t + h/2, as
the engines' own semi-implicit Euler does with the joint's: every force is meant at t, and but for
EXTRA_DAMPING a motion is right to second order in h. Linearly implicit in the rotor's new velocity v'; its velocity at
t is v̄ = (v + v')/2:

    gear      s = twist ∓ backlash/2,  twist = rotor_pos - joint_pos, in contact where twist + h/2·(v - dq) is beyond
              the play;  D = gear_damping + EXTRA_DAMPING·h·gear_stiffness
              τ_gear = gear_stiffness·(s + h/2·(v̄ - v)) + D·(v̄ - dq)
    friction  F = coulomb + load_friction·|gear_stiffness·s + D·(v - dq)| + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    law       τ_law = clip(kp·(position_target - θ) - kd·filtered, ±torque_limit),  θ = rotor_pos + h/2·(v̄ - v) +
              encoder_zero; delayed target and filtered velocity are means over the step, t - h/2 to t + h/2
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v̄ - τ_gear - F·sign(v'),  stuck where F is enough

The joint gets torque = τ_gear + d·dq and damping d = (gear_damping + h·gear_stiffness)/2 while the gear touches, for
the engine to integrate implicitly: a stiff gear on a light shank then stays stable. What that takes from the joint is
given back to the rotor one step later, so that momentum is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from motorprior.actuator.delay_line import delayed_target
from motorprior.actuator.vector import BYTES, Vector, where

PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "backlash", "gear_damping", "encoder_zero",
)  # fmt: skip
"""Units as in `physical.MotorParameters`; kd_over_kp [s]."""
EXTRA_DAMPING = 0.1
"""Of the gear, so that a bare shank does not chatter [steps of its stiffness]."""
RESOLVED = 1.5
"""Largest gear_stiffness·h²/armature: a stiffer gear is simulated as if it were only so stiff, or it would explode."""
LONGEST_DELAY = 0.04
"""[s]; a motor keeps its commands for so long."""
LOG_REACH = 2.5
"""A constant of a drawn motor is within a factor of 12 of the central motor's."""
ZERO_SCALE = 0.05
"""[rad]"""
STRIBECK_VELOCITY = 0.3
"""[rad/s]"""

(
    _KP, _KD, _FILTER, _DELAY, _LIMIT, _ARMATURE, _COULOMB, _STRIBECK, _VISCOUS, _LOAD_FRICTION,
    STIFFNESS, _HALF_PLAY, _GEAR_DAMPING, _ZERO, _MEAN_FILTER,
) = range(len(PARAMETERS) + 1)  # fmt: skip
ROTOR_POS, ROTOR_VEL, FILTERED_VEL, JOINT_VEL, DAMPING, TARGET, _RING = range(7)
"""Rows of the memory; the delay line follows."""


@dataclass(frozen=True)
class GearedMotor:
    """Linear map from z to the logarithms of the constants; P = 14 parameters, Z latents."""

    center: np.ndarray
    """(P,)"""
    slope: np.ndarray
    """(Z, P)"""

    def decode(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) constants by name of motors with latents z (n, Z)."""
        shift = np.einsum("nz,zp->np", z, self.slope)  # not @, whose rounding depends on the number of motors
        raw = self.center + np.clip(shift, -LOG_REACH, LOG_REACH)
        values: dict[str, np.ndarray] = dict(zip(PARAMETERS, np.exp(raw).T.copy(), strict=True))
        values["delay"] = np.minimum(values["delay"], LONGEST_DELAY)
        values["encoder_zero"] = ZERO_SCALE * raw[:, _ZERO]
        return values


def motor_table(values: dict[str, np.ndarray], physics_dt: float) -> np.ndarray:
    """(P + 1, n) constants as the compiled step wants them: kd, half the play, delay in steps, gains of the filter.

    Of a filter with time constant T, the velocity after a step moves by 1 - exp(-h/T) towards the input, its mean over
    the step by 1 - (1 - exp(-h/T))·T/h.
    """
    table = np.stack([values[name] for name in PARAMETERS])
    steps = physics_dt / values["velocity_filter"]
    table[_KD] = values["kp"] * values["kd_over_kp"]
    table[_DELAY] = values["delay"] / physics_dt
    table[_FILTER] = -np.expm1(-steps)
    table[STIFFNESS] = np.minimum(values["gear_stiffness"], RESOLVED * values["armature"] / physics_dt**2)
    table[_HALF_PLAY] = 0.5 * values["backlash"]
    return np.concatenate([table, [1.0 - table[_FILTER] / steps]])


def memory_rows(physics_dt: float) -> int:
    """Rows of the memory at this physics step [s]."""
    return _RING + math.ceil(LONGEST_DELAY / physics_dt - 1e-9) + 3


@njit(cache=True, nogil=True)
def reset_geared_motor(memory: np.ndarray, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest above the joint, in the middle of the play."""
    memory[:_RING, :] = 0.0
    memory[ROTOR_POS, :] = joint_pos
    for row in range(_RING, memory.shape[0]):
        memory[row, :] = position_target


@njit(cache=True, nogil=True)
def _listen(p: np.ndarray, memory: np.ndarray, now: int, position_target: np.ndarray) -> None:
    """Delayed targets, linear between steps: their means from half a step before to half a step after now."""
    newest = now % (memory.shape[0] - _RING)
    for motor in range(position_target.shape[0]):
        memory[_RING + newest, motor] = position_target[motor]
        memory[TARGET, motor] = delayed_target(memory, _RING, newest, p[_DELAY, motor] + 0.5, motor)


class Rotor(NamedTuple):
    """What a step changes, of as many motors as there are lanes."""

    pos: Vector
    vel: Vector
    filtered: Vector


def _rub(impulse: Vector, friction: Vector) -> Vector:
    """What dry friction leaves of an impulse: it can stop a rotor, never reverse it."""
    rest = abs(impulse) - friction
    return where(rest > 0.0, rest, 0.0 * rest).with_sign_of(impulse)


def _step(
    p: list[Vector], rotor: Rotor, target: Vector, q: Vector, dq: Vector, h: Vector
) -> tuple[Rotor, Vector, Vector]:
    """Rotors after ``h``, the gears' torque and the damping for the engine."""
    r, v, filtered = rotor.pos, rotor.vel, rotor.filtered
    half_h, zero, one = 0.5 * h, 0.0 * h, 0.0 * h + 1.0  # in every lane
    twist, half_play = r - q, p[_HALF_PLAY]
    coming = twist + half_h * (v - dq)
    above, below = coming > half_play, coming < -half_play
    pressed = where(above, twist - half_play, where(below, twist + half_play, zero))
    contact = where(above, one, where(below, one, zero))
    stiffness, damper = contact * p[STIFFNESS], contact * p[_GEAR_DAMPING]
    damping = 0.5 * (damper + h * stiffness)
    damper = damper + EXTRA_DAMPING * h * stiffness
    gear, lead = stiffness * pressed + damper * (v - dq), damper + half_h * stiffness

    ratio = v / STRIBECK_VELOCITY
    friction = p[_COULOMB] + p[_STRIBECK] / (1.0 + ratio * ratio)
    friction = h * (friction + p[_LOAD_FRICTION] * abs(gear))
    # forces are those at v, plus their slopes times v̄ - v = (v' - v)/2
    push = p[_KP] * (target - r - p[_ZERO]) - p[_KD] * (filtered + p[_MEAN_FILTER] * (v - filtered))
    braking = p[_KD] * p[_MEAN_FILTER] + half_h * p[_KP]
    inertia = p[_ARMATURE] + half_h * (lead + p[_VISCOUS])
    carried = inertia * v - h * (gear + p[_VISCOUS] * v)
    free = _rub(carried + h * push + half_h * braking * v, friction) / (inertia + half_h * braking)
    law = push - 0.5 * braking * (free - v)
    held = _rub(carried + h * law.clipped(p[_LIMIT]), friction) / inertia
    after = where(abs(law) > p[_LIMIT], held, free)

    mean = 0.5 * (v + after)
    moved = Rotor(r + h * after, after, filtered + p[_FILTER] * (mean - filtered))
    return moved, gear + lead * (mean - v), damping


def _emit_step(builder: Any, width: int, columns: list[Any], physics_dt: Any) -> None:
    """One physics step for ``width`` neighbouring motors.

    Args:
        builder: of the code (llvmlite).
        width: number of motors.
        columns: of table, memory, joint_pos, joint_vel, torque and damping: (address of the first motor's element in
            the first row, bytes from row to row).
        physics_dt: [s].
    """
    table, memory, *vectors = columns

    def read(column: Any, row: int = 0) -> Vector:
        return Vector.load(builder, _row(builder, column, row), width)

    p = [read(table, row) for row in range(len(PARAMETERS) + 1)]
    q, dq = (read(column) for column in vectors[:2])
    h = Vector.broadcast(builder, physics_dt, width)
    # the momentum that the engine's implicit damping took from the joint
    vel = read(memory, ROTOR_VEL) + h * read(memory, DAMPING) * (dq - read(memory, JOINT_VEL)) / p[_ARMATURE]
    before = Rotor(read(memory, ROTOR_POS), vel, read(memory, FILTERED_VEL))
    rotor, gear, damping = _step(p, before, read(memory, TARGET), q, dq, h)
    (gear + damping * dq).store(_row(builder, vectors[2], 0))
    damping.store(_row(builder, vectors[3], 0))
    left = {ROTOR_POS: rotor.pos, ROTOR_VEL: rotor.vel, FILTERED_VEL: rotor.filtered, JOINT_VEL: dq, DAMPING: damping}
    for row, value in left.items():
        value.store(_row(builder, memory, row))


def _row(builder: Any, column: Any, row: int) -> Any:
    """Address of a column's element in that row."""
    first, stride = column
    return builder.add(first, builder.mul(stride, ir.Constant(stride.type, row)))


def _stepper(width: int) -> Any:
    """An intrinsic that steps ``width`` motors."""

    def step(typingctx, first, table, memory, joint_pos, joint_vel, torque, damping, physics_dt):
        """From motor number ``first`` on; the arrays are those of `step_geared_motor`."""
        arrays = (table, memory, joint_pos, joint_vel, torque, damping)
        if any(array.layout != "C" or array.dtype != types.float64 for array in arrays):
            raise TypingError("the motors' arrays must be contiguous float64")
        signature = types.void(types.intp, *arrays, types.float64)

        def codegen(context, builder, signature, arguments):
            first, *values, physics_dt = arguments
            columns = [
                _column(context, builder, kind, value, first)
                for kind, value in zip(signature.args[1:], values, strict=False)
            ]
            _emit_step(builder, width, columns, physics_dt)
            return context.get_dummy_value()

        return signature, codegen

    return intrinsic(step)


def _column(context: Any, builder: Any, kind: Any, value: Any, index: Any) -> tuple[Any, Any]:
    """Address of element ``index`` of an array's first row, and bytes from row to row."""
    array = context.make_array(kind)(context, builder, value=value)
    start = builder.ptrtoint(array.data, index.type)
    first = builder.add(start, builder.mul(index, ir.Constant(index.type, BYTES)))
    return first, cgutils.unpack_tuple(builder, array.strides)[0]


_step_eight, _step_four, _step_one = _stepper(8), _stepper(4), _stepper(1)


@njit(cache=True, nogil=True)
def step_geared_motor(
    p: np.ndarray,
    memory: np.ndarray,
    now: int,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
    damping: np.ndarray,
) -> None:
    """Write (n,) torque [N·m] and damping [N·m·s/rad] for the physics step that begins now.

    Args:
        p: (P + 1, n) of `motor_table` for this step. All arrays are contiguous.
        memory: (rows, n) state.
        now: steps since the reset.
        physics_dt: [s].
        position_target: (n,) [rad].
        joint_pos: (n,) [rad].
        joint_vel: (n,) [rad/s].
        torque: (n,) overwritten.
        damping: (n,) overwritten.
    """
    _listen(p, memory, now, position_target)
    n, first = torque.shape[0], 0
    while first < n:
        if n - first >= 8:
            _step_eight(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt)
            first += 8
        elif n - first >= 4:
            _step_four(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt)
            first += 4
        else:
            _step_one(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt)
            first += 1


@njit(cache=True, nogil=True, inline="always")
def read_rotor_encoders(p: np.ndarray, memory: np.ndarray, out: np.ndarray) -> None:
    """(n,) encoder angle [rad]: rotor position plus encoder zero."""
    for motor in range(out.shape[0]):
        out[motor] = memory[ROTOR_POS, motor] + p[_ZERO, motor]
