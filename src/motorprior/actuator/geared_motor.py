"""The physical half of the grey-box decoder: a latent z becomes the constants of a servo, rotor and gear.

    log θ = center + zᵀ·slope            θ: the 14 PARAMETERS, kept within e^±LOG_REACH of the centre;
                                         encoder_zero = ZERO_SCALE·(center + zᵀ·slope), which may be negative

All quantities at the output shaft. The motor is advanced in substeps h of at most SUBSTEP, linearly implicit in the
rotor's velocity v', while the joint moves on at its present velocity dq:

    gear      s = twist ∓ backlash/2,  twist = rotor_pos - joint_pos;  in contact where twist + h·(v - dq) is beyond
              the play;  D = gear_damping + IMPLICITNESS·h·gear_stiffness;  τ_gear = gear_stiffness·s + D·(v' - dq)
    friction  F = coulomb + load_friction·|τ_gear| + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    law       τ_law = clip(kp·(position_target(t - delay) - θ) - kd·v_filtered', ±torque_limit),
              θ = rotor_pos + h·v'/2 + encoder_zero
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v' - τ_gear - F·sign(v'),  stuck where F is enough

The joint gets torque = mean τ_gear + d·dq and damping d = share of the step in contact · (gear_damping +
step·gear_stiffness)/2 for the engine to integrate implicitly (the mean over the step, to second order in it): a stiff
gear on a light shank then stays stable. What that takes from the joint is given back to the rotor one step later, so
that momentum is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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
SUBSTEP = 0.001
"""Longest substep [s]."""
IMPLICITNESS = 0.65
"""Share of the end of a substep in the gear's spring: 0.5 is exact to second order, 1 damps most."""
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
    _STIFFNESS, _HALF_PLAY, _GEAR_DAMPING, _ZERO,
) = range(len(PARAMETERS))  # fmt: skip
ROTOR_POS, ROTOR_VEL, FILTERED_VEL, JOINT_VEL, DAMPING, TARGET, CONTACT, _RING = range(8)
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
    """(P, n) constants as the compiled step wants them: kd, half the play, delay in steps, filter gain per substep."""
    table = np.stack([values[name] for name in PARAMETERS])
    table[_KD] = values["kp"] * values["kd_over_kp"]
    table[_DELAY] = values["delay"] / physics_dt
    table[_FILTER] = 1.0 - np.exp(-physics_dt / _substeps(physics_dt) / values["velocity_filter"])
    table[_HALF_PLAY] = 0.5 * values["backlash"]
    return table


def memory_rows(physics_dt: float) -> int:
    """Rows of the memory at this physics step [s]."""
    return _RING + math.ceil(LONGEST_DELAY / physics_dt - 1e-9) + 2


@njit(cache=True, nogil=True, inline="always")
def _substeps(physics_dt: float) -> int:
    return max(1, math.ceil(physics_dt / SUBSTEP - 1e-9))


@njit(cache=True, nogil=True)
def reset_geared_motor(memory: np.ndarray, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest above the joint, in the middle of the play."""
    memory[:_RING, :] = 0.0
    memory[ROTOR_POS, :] = joint_pos
    for row in range(_RING, memory.shape[0]):
        memory[row, :] = position_target


@njit(cache=True, nogil=True)
def _listen(p: np.ndarray, memory: np.ndarray, now: int, position_target: np.ndarray) -> None:
    """Delayed targets, linear between steps."""
    newest = now % (memory.shape[0] - _RING)
    for motor in range(position_target.shape[0]):
        memory[_RING + newest, motor] = position_target[motor]
        memory[TARGET, motor] = delayed_target(memory, _RING, newest, p[_DELAY, motor], motor)


class Rotor(NamedTuple):
    """What changes in a substep, of as many motors as there are lanes; force and contact are sums over the step."""

    pos: Vector
    vel: Vector
    filtered: Vector
    force: Vector
    contact: Vector


def _rub(impulse: Vector, friction: Vector) -> Vector:
    """What dry friction leaves of an impulse: it can stop a rotor, never reverse it."""
    rest = abs(impulse) - friction
    return where(rest > 0.0, rest, 0.0 * rest).with_sign_of(impulse)


def _substep(p: list[Vector], rotor: Rotor, target: Vector, q: Vector, dq: Vector, h: Vector, ahead: Vector) -> Rotor:
    """Advance rotors by ``h``; the joints are where they will be after ``ahead`` [s] of their present velocity."""
    r, v, filtered = rotor.pos, rotor.vel, rotor.filtered
    zero, one = 0.0 * h, 0.0 * h + 1.0  # in every lane
    twist, half = r - q - ahead * dq, p[_HALF_PLAY]
    coming = twist + h * (v - dq)
    above, below = coming > half, coming < -half
    pressed = where(above, twist - half, where(below, twist + half, zero))
    contact = where(above, one, where(below, one, zero))
    spring = contact * p[_STIFFNESS] * pressed
    damping = contact * (p[_GEAR_DAMPING] + IMPLICITNESS * h * p[_STIFFNESS])
    ratio = v / STRIBECK_VELOCITY
    friction = p[_COULOMB] + p[_STRIBECK] / (1.0 + ratio * ratio)
    friction = h * (friction + p[_LOAD_FRICTION] * abs(spring + damping * (v - dq)))
    gain = p[_FILTER]
    braking = p[_KD] * gain + 0.5 * h * p[_KP]
    push = p[_KP] * (target - r - p[_ZERO]) - p[_KD] * (1.0 - gain) * filtered
    carried = p[_ARMATURE] * v + h * (damping * dq - spring)
    inertia = p[_ARMATURE] + h * (p[_VISCOUS] + damping)
    free = _rub(carried + h * push, friction) / (inertia + h * braking)
    law = push - braking * free
    held = _rub(carried + h * law.clipped(p[_LIMIT]), friction) / inertia
    v = where(abs(law) > p[_LIMIT], held, free)
    force = rotor.force + (spring + damping * (v - dq))
    return Rotor(r + h * v, v, filtered + gain * (v - filtered), force, rotor.contact + contact)


def _emit_step(builder: Any, width: int, columns: list[Any], physics_dt: Any, substeps: Any) -> None:
    """All substeps of one physics step, for ``width`` neighbouring motors.

    Args:
        builder: of the code (llvmlite).
        width: number of motors.
        columns: of table, memory, joint_pos, joint_vel, torque and damping: (address of the first motor's element in
            the first row, bytes from row to row).
        physics_dt: [s].
        substeps: their number.
    """
    table, memory, *vectors = columns

    def read(column: Any, row: int = 0) -> Vector:
        return Vector.load(builder, _row(builder, column, row), width)

    p = [read(table, row) for row in range(len(PARAMETERS))]
    q, dq = (read(column) for column in vectors[:2])
    dt = Vector.broadcast(builder, physics_dt, width)
    count = Vector.broadcast(builder, builder.sitofp(substeps, physics_dt.type), width)
    h, target, zero = dt / count, read(memory, TARGET), 0.0 * dt
    # the momentum that the engine's implicit damping took from the joint
    vel = read(memory, ROTOR_VEL) + dt * read(memory, DAMPING) * (dq - read(memory, JOINT_VEL)) / p[_ARMATURE]
    rotor = _repeated(
        builder, substeps, Rotor(read(memory, ROTOR_POS), vel, read(memory, FILTERED_VEL), zero, zero),
        lambda now, k: _substep(p, now, target, q, dq, h, Vector.broadcast(builder, k, width) * h),
    )  # fmt: skip
    damping = 0.5 * (rotor.contact / count) * (p[_GEAR_DAMPING] + dt * p[_STIFFNESS])
    (rotor.force / count + damping * dq).store(_row(builder, vectors[2], 0))
    damping.store(_row(builder, vectors[3], 0))
    left = {
        ROTOR_POS: rotor.pos, ROTOR_VEL: rotor.vel, FILTERED_VEL: rotor.filtered, JOINT_VEL: dq, DAMPING: damping,
        CONTACT: rotor.contact,
    }  # fmt: skip
    for row, value in left.items():
        value.store(_row(builder, memory, row))


def _row(builder: Any, column: Any, row: int) -> Any:
    """Address of a column's element in that row."""
    first, stride = column
    return builder.add(first, builder.mul(stride, ir.Constant(stride.type, row)))


def _repeated(builder: Any, count: Any, start: Rotor, advance: Callable[[Rotor, Any], Rotor]) -> Rotor:
    """``advance`` of the state and the number of the substep (a float64 of the code), ``count`` times."""
    slots = [cgutils.alloca_once_value(builder, part.value) for part in start]
    with cgutils.for_range(builder, count) as loop:
        now = Rotor(*(Vector(builder, builder.load(slot)) for slot in slots))
        after = advance(now, builder.sitofp(loop.index, ir.DoubleType()))
        for slot, part in zip(slots, after, strict=True):
            builder.store(part.value, slot)
    return Rotor(*(Vector(builder, builder.load(slot)) for slot in slots))


def _stepper(width: int) -> Any:
    """An intrinsic that steps ``width`` motors."""

    def step(typingctx, first, table, memory, joint_pos, joint_vel, torque, damping, physics_dt, substeps):
        """From motor number ``first`` on; the arrays are those of `step_geared_motor`."""
        arrays = (table, memory, joint_pos, joint_vel, torque, damping)
        if any(array.layout != "C" or array.dtype != types.float64 for array in arrays):
            raise TypingError("the motors' arrays must be contiguous float64")
        signature = types.void(types.intp, *arrays, types.float64, types.intp)

        def codegen(context, builder, signature, arguments):
            first, *values, physics_dt, substeps = arguments
            columns = [
                _column(context, builder, kind, value, first)
                for kind, value in zip(signature.args[1:], values, strict=False)
            ]
            _emit_step(builder, width, columns, physics_dt, substeps)
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
        p: (P, n) of `motor_table` for this step. All arrays are contiguous.
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
    n, substeps, first = torque.shape[0], _substeps(physics_dt), 0
    while first < n:
        if n - first >= 8:
            _step_eight(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt, substeps)
            first += 8
        elif n - first >= 4:
            _step_four(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt, substeps)
            first += 4
        else:
            _step_one(first, p, memory, joint_pos, joint_vel, torque, damping, physics_dt, substeps)
            first += 1


@njit(cache=True, nogil=True, inline="always")
def read_rotor_encoders(p: np.ndarray, memory: np.ndarray, out: np.ndarray) -> None:
    """(n,) encoder angle [rad]: rotor position plus encoder zero."""
    for motor in range(out.shape[0]):
        out[motor] = memory[ROTOR_POS, motor] + p[_ZERO, motor]
