"""Grey boxes: compiled geared motors whose constants are decoded from a latent z.

    log θ = center + zᵀ·slope,   within ±MAX_LOG_FACTOR of center

θ are the 14 PARAMETERS and the constants of the optional terms. Constants that may be negative
(`optional_terms.SIGNED`) are linear in z.

A step is the formula of `geared_motor_step`, traced into compiled code with one lane per motor, for
position commands and for the command frames of MIT mode (`command_frame`). The model simulates the
rotor, so the engine gets no armature.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from motorprior.actuator.actuator import ConstantFactors, empty_arrays, require_step
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.command_frame import (
    IN_FORCE,
    KP_FACTOR,
    QUANTITIES,
    delay_frames,
    mean_target,
)
from motorprior.actuator.copula import Copula
from motorprior.actuator.geared_motor_step import (
    BASE_CONSTANTS,
    BASE_STATE,
    MAX_DELAY,
    MAX_LOG_FACTOR,
    CommandFrame,
    MotorState,
    StepConstants,
    decode,
    step,
    step_constants,
    with_logged_gains,
)
from motorprior.actuator.kernels import ActuatorKind, without_refcounts
from motorprior.actuator.optional_terms import (
    COLD,
    HALF_WARM,
    REFERENCE,
    TERMS,
    OperatingConditions,
)
from motorprior.actuator.vector import LANE_ARITHMETIC, Vector
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line
from motorprior.exceptions import ConfigError

# rows of the table
STIFFNESS = StepConstants._fields.index("gear_stiffness")
_KP = StepConstants._fields.index("kp")
_KD = StepConstants._fields.index("kd")
_DELAY = StepConstants._fields.index("delay")
_ZERO = StepConstants._fields.index("encoder_zero")
_HALF_BACKLASH = StepConstants._fields.index("half_backlash")
HIDDEN_TWIST = StepConstants._fields.index("hidden_twist")
# rows of the memory: the state, the delayed target, the delay line
ROTOR_POS = MotorState._fields.index("rotor_pos")
ROTOR_VEL = MotorState._fields.index("rotor_vel")
FILTERED_VEL = MotorState._fields.index("filtered_vel")
JOINT_VEL = MotorState._fields.index("joint_vel")
DAMPING = MotorState._fields.index("damping")
REFERENCE_ROW = MotorState._fields.index(REFERENCE)
TARGET = len(MotorState._fields)
LINE = len(MotorState._fields) + 1


def motor_table(
    values: dict[str, np.ndarray], physics_dt: float, terms: tuple[str, ...] = ()
) -> np.ndarray:
    """(rows, n) of `StepConstants` from constants by name, for steps of ``physics_dt`` [s].

    Motors with terms have more rows.
    """
    rows = step_constants(values, physics_dt, terms)
    return np.stack([row for row in rows if row is not None])


def memory_rows(physics_dt: float) -> int:
    """Rows of the memory at this physics step [s]."""
    return LINE + math.ceil(MAX_DELAY / physics_dt - 1e-9) + 3


@dataclass(frozen=True)
class GreyBox:
    """Decoder from Z latents to the logarithms of the P constants of a geared motor."""

    center: np.ndarray  # (P,)
    slope: np.ndarray  # (Z, P)
    period: float  # sample period of the fitted logs, the largest physics step [s]
    terms: tuple[str, ...] = ()  # names in `optional_terms`, in that order
    # maps z ~ N(0, I) to the latents of the decoder; if it is None, these latents are z
    copula: Copula | None = None
    # unit of the logged gains (`MotorLog`), of which kp and kd_over_kp are multiples; "" if kp and
    # kd_over_kp are absolute
    gain_unit: str = ""
    # command mode of the fitted logs, one of `motor_log.COMMAND_MODES`; kp has no meaning for
    # velocity commands, and neither gain has for torque commands
    command_mode: str = "position"

    @property
    def num_latents(self) -> int:
        """Z."""
        return len(self.slope)

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for motors with latents z (n, Z)."""
        return z if self.copula is None else self.copula.decoder_latents(z)

    def constants(
        self, z: np.ndarray, operating_conditions: OperatingConditions = COLD
    ) -> dict[str, np.ndarray]:
        """(n,) physical constants by name at these operating conditions.

        By default the motors are cold, at nominal supply voltage and temperature. With a
        ``gain_unit``, kp and kd_over_kp are multiples of the logged gains (`with_logged_gains`).
        """
        return decode(self.outputs(z), self.terms, operating_conditions)

    def outputs(self, z: np.ndarray) -> np.ndarray:
        """(n, P) decoder outputs of motors with latents z (n, Z)."""
        # einsum instead of @, whose rounding depends on the number of motors
        shift = np.einsum("nz,zp->np", self.decoder_latents(z), self.slope)
        return self.center + np.clip(shift, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        return self.constants(z)["armature"]

    def warmth(self, z: np.ndarray, seconds: float) -> np.ndarray | float:
        """(n,) warmth of motors ``seconds`` [s] after a cold start; 0 without the term heat."""
        if "heat" not in self.terms:
            return 0.0
        return 1.0 - np.exp(-seconds / self.constants(z)["heat_time"])

    def motors(
        self,
        z: np.ndarray,
        operating_conditions: OperatingConditions = HALF_WARM,
        gains: np.ndarray | None = None,
    ) -> "GreyBoxActuator":
        """Motors with latents z (n, Z)."""
        return GreyBoxActuator(self, z, operating_conditions, gains)


@dataclass(frozen=True, repr=False)
class GreyBoxActuator:
    """n motors of one grey box."""

    model: GreyBox  # shared by all motors
    z: np.ndarray  # (n, Z)
    operating_conditions: OperatingConditions = HALF_WARM
    # (2, n) kp and kd in the model's ``gain_unit``; if the unit is "", factors on kp and kd
    gains: np.ndarray | None = None
    factors: ConstantFactors | None = None  # multiply the constants
    # velocity: kp is 0; torque: kp and kd are 0, and the motors obey feed-forward torques alone
    command_mode: str = "position"

    def __repr__(self) -> str:
        return f"{self.num_motors} grey-box motors, see constants()"

    def _repr_html_(self) -> str:  # of notebooks
        from motorprior.actuator.constants import html_of_motors  # here: it imports this module

        if self.model.gain_unit and self.gains is None:  # no constants without gains
            return f"<p>{self!r}</p>"
        return f"<p>{self!r}</p>\n{html_of_motors(self.constants())}"

    @property
    def kind(self) -> ActuatorKind:
        """GREY_BOX."""
        return GREY_BOX

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.z)

    @property
    def armature(self) -> np.ndarray:
        """(n,) zero [kg·m²]: the model simulates the rotor."""
        return np.zeros(self.num_motors)

    @property
    def damping(self) -> np.ndarray:
        """(n,) zero [N·m·s/rad]: before the first step, no gear is in contact."""
        return np.zeros(self.num_motors)

    def with_factors(self, factors: ConstantFactors) -> "GreyBoxActuator":
        """See `Actuator.with_factors`. The integral gain, kp·integral_rate, scales with kp."""
        if self.factors is not None:
            factors = ConstantFactors(*np.multiply(self.factors, factors))
        return replace(self, factors=factors)

    def constants(self) -> dict[str, np.ndarray]:
        """(n,) constants by name at the operating conditions, with the gains and factors."""
        if self.model.gain_unit and self.gains is None:
            problem = f"these motors were learned with logged gains [{self.model.gain_unit}]"
            raise ConfigError(problem, remedy="give their gains", argument="gains")

        values = self.model.constants(self.z, self.operating_conditions)
        if self.gains is not None:
            values = with_logged_gains(values, *self.gains)
        if self.factors is None:
            return values

        values = with_logged_gains(values, self.factors.kp, self.factors.kd)
        values["torque_limit"] = values["torque_limit"] * self.factors.torque_limit
        for friction in ("coulomb", "stribeck_torque"):
            values[friction] = values[friction] * self.factors.coulomb
        return values

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`; also raises `ConfigError` if the gains are missing."""
        require_step(physics_dt, self.model.period)
        return empty_arrays(GREY_BOX, self.table(physics_dt), memory_rows(physics_dt), 1)

    def table(self, physics_dt: float) -> np.ndarray:
        """`motor_table` at the gains of the command mode."""
        table = motor_table(self.constants(), physics_dt, self.model.terms)
        if self.command_mode in ("velocity", "torque"):
            table[_KP] = 0.0
        if self.command_mode == "torque":
            table[_KD] = 0.0
        return table


@njit(cache=True, nogil=True)
def reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Put static rotors at the angles of the joints, in the middle of the backlash."""
    memory = arrays.memory
    memory[:LINE, :] = 0.0
    memory[ROTOR_POS, :] = joint_pos
    memory[REFERENCE_ROW, :] = position_target
    fill_line(memory, LINE, position_target)


@njit(cache=True, nogil=True)
def _update_targets(
    p: np.ndarray, memory: np.ndarray, now: int, position_target: np.ndarray
) -> None:
    """Write the delayed targets [rad], interpolated linearly.

    A delayed target is the mean from half a step before now to half a step after now.
    """
    newest = write_line(memory, LINE, now, position_target)
    for motor in range(position_target.shape[0]):
        memory[TARGET, motor] = interpolated(memory, LINE, newest, p[_DELAY, motor] + 0.5, motor)


def _emit_step(
    builder: Any,
    width: int,
    columns: list[Any],
    frame_columns: list[Any],
    physics_dt: Any,
    terms: tuple[str, ...],
) -> None:
    """Emit one physics step for ``width`` consecutive motors.

    ``columns`` has a pair (address of the first motor in the first row, bytes between rows) for
    each of table, memory, joint_pos, joint_vel, torque and damping. ``frame_columns`` has such a
    pair for each quantity of the command frames; it is empty for position commands.
    """
    table, memory, *vectors = columns
    constants = len(StepConstants._fields) if terms else BASE_CONSTANTS
    states = len(MotorState._fields) if terms else BASE_STATE

    def read(column: Any, row: int = 0) -> Vector:
        return Vector.load(builder, _row(builder, column, row), width)

    p = StepConstants(*(read(table, row) for row in range(constants)))
    state = MotorState(*(read(memory, row) for row in range(states)))
    q, dq = (read(column) for column in vectors[:2])
    h = Vector.broadcast(builder, physics_dt, width)
    target = read(memory, TARGET)
    frame = None
    if frame_columns:
        frame = CommandFrame(*(read(column, IN_FORCE) for column in frame_columns))
    state, torque, damping = step(p, state, target, q, dq, h, LANE_ARITHMETIC, terms, frame)

    torque.store(_row(builder, vectors[2], 0))
    damping.store(_row(builder, vectors[3], 0))
    for row, value in enumerate(state[:states]):
        value.store(_row(builder, memory, row))


def _row(builder: Any, column: Any, row: int) -> Any:
    first, stride = column
    return builder.add(first, builder.mul(stride, ir.Constant(stride.type, row)))


def _stepper(width: int, terms: tuple[str, ...], with_frames: bool = False) -> Any:
    def stepper(
        typingctx, first, table, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt
    ):
        arrays = (table, memory, joint_pos, joint_vel, torque, damping, frames)
        signature = types.void(types.intp, *arrays, types.float64)

        def codegen(context, builder, signature, arguments):
            first, *values, physics_dt = arguments
            columns = [
                _column(context, builder, array_type, value, first)
                for array_type, value in zip(signature.args[1:], values, strict=False)
            ]
            frame_columns = _quantities(builder, columns.pop()) if with_frames else []
            _emit_step(builder, width, columns[:6], frame_columns, physics_dt, terms)
            return context.get_dummy_value()

        return signature, codegen

    return intrinsic(stepper)


def _column(context: Any, builder: Any, array_type: Any, value: Any, index: Any) -> tuple[Any, Any]:
    """Address of element ``index`` in the first row of an array, and bytes between rows."""
    array = context.make_array(array_type)(context, builder, value=value)
    start = builder.ptrtoint(array.data, index.type)
    first = builder.add(start, builder.mul(index, ir.Constant(index.type, 8)))
    return first, cgutils.unpack_tuple(builder, array.strides)[0]


def _quantities(builder: Any, frames: Any) -> list[Any]:
    """Columns, as `_column`, of each quantity of the command frames."""
    first, stride = frames
    quantity_bytes = builder.udiv(stride, ir.Constant(stride.type, QUANTITIES))
    columns = []
    for quantity in range(QUANTITIES):
        offset = builder.mul(quantity_bytes, ir.Constant(stride.type, quantity))
        columns.append((builder.add(first, offset), stride))
    return columns


_step_eight = _stepper(8, ())
_step_four = _stepper(4, ())
_step_one = _stepper(1, ())
_servo_eight = _stepper(8, tuple(TERMS))
_servo_one = _stepper(1, tuple(TERMS))
_framed_eight = _stepper(8, (), with_frames=True)
_framed_one = _stepper(1, (), with_frames=True)
_framed_servo_eight = _stepper(8, tuple(TERMS), with_frames=True)
_framed_servo_one = _stepper(1, tuple(TERMS), with_frames=True)


@njit(cache=True, nogil=True)
def step_lanes(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    """Write the torque and the damping for the coming physics step; see `ActuatorKind`.

    The table has more than BASE_CONSTANTS rows for motors with optional terms.
    """
    # one after the other: a tuple would count each array once more
    arrays = without_refcounts(arrays)
    torque = without_refcounts(torque)
    position_target = without_refcounts(position_target)
    joint_pos = without_refcounts(joint_pos)
    joint_vel = without_refcounts(joint_vel)
    p = arrays.parameters
    memory = arrays.memory
    now = arrays.clock[0]
    damping = arrays.damping
    frames = without_refcounts(arrays.frames)
    _update_targets(p, memory, now, position_target)
    if frames.shape[0] > 0:
        delay_frames(frames, now, p[_DELAY], 0.5)
        for motor in range(torque.shape[0]):
            age = p[_DELAY, motor] + 0.5
            memory[TARGET, motor] = mean_target(memory, LINE, frames, now, age, motor, KP_FACTOR)
        _step_framed(p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
        return

    # motors in groups of eight, four and one
    n = torque.shape[0]
    first = 0
    servo = p.shape[0] > BASE_CONSTANTS
    while first < n:
        if servo and n - first >= 8:
            _servo_eight(
                first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt
            )
            first += 8
        elif servo:
            _servo_one(first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
            first += 1
        elif n - first >= 8:
            _step_eight(first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
            first += 8
        elif n - first >= 4:
            _step_four(first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
            first += 4
        else:
            _step_one(first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
            first += 1


@njit(cache=True, nogil=True)
def _step_framed(p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt):
    """Step of motors that get command frames, in groups of eight and one."""
    n = torque.shape[0]
    first = 0
    servo = p.shape[0] > BASE_CONSTANTS
    while first < n:
        if servo and n - first >= 8:
            _framed_servo_eight(
                first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt
            )
            first += 8
        elif servo:
            _framed_servo_one(
                first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt
            )
            first += 1
        elif n - first >= 8:
            _framed_eight(
                first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt
            )
            first += 8
        else:
            _framed_one(first, p, memory, joint_pos, joint_vel, torque, damping, frames, physics_dt)
            first += 1


@njit(cache=True, nogil=True)
def read_encoders(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """Write the encoder angles [rad]: rotor position - `hidden_twist_of` + encoder zero."""
    for motor in range(out.shape[0]):
        twist = hidden_twist_of(arrays, motor, joint_pos[motor])
        out[motor] = arrays.memory[ROTOR_POS, motor] - twist + arrays.parameters[_ZERO, motor]


@njit(cache=True, nogil=True)
def hidden_twist_of(arrays: ActuatorArrays, motor: int, joint_pos: float) -> float:
    """Part [rad] of a gear's twist that only its softening for the step adds."""
    twist = arrays.memory[ROTOR_POS, motor] - joint_pos
    half_backlash = arrays.parameters[_HALF_BACKLASH, motor]
    deflection = twist - min(max(twist, -half_backlash), half_backlash)
    return arrays.parameters[HIDDEN_TWIST, motor] * deflection


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    # the engine does not damp, so its damping adds no momentum to the rotors in the next step
    for motor in range(torque.shape[0]):
        torque[motor] -= arrays.damping[motor] * joint_vel[motor]
    arrays.damping[:] = 0.0
    arrays.memory[DAMPING, :] = 0.0


def _limit_stiffness(arrays: ActuatorArrays, max_stiffness: float) -> None:
    stiffness = arrays.parameters[STIFFNESS]
    hidden_twist = arrays.parameters[HIDDEN_TWIST]
    stiffness_ratio = np.minimum(1.0, max_stiffness / stiffness)
    arrays.parameters[HIDDEN_TWIST] = 1.0 - (1.0 - hidden_twist) * stiffness_ratio
    arrays.parameters[STIFFNESS] = np.minimum(stiffness, max_stiffness)


GREY_BOX = ActuatorKind(
    "grey_box",
    "grey box",
    reset=reset,
    step=step_lanes,
    read_encoders=read_encoders,
    make_explicit=_make_explicit,
    limit_stiffness=_limit_stiffness,
    takes_frames=True,
)
