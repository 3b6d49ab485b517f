"""Geared motors as one Warp kernel in float32, traced from the formula of the compiled step (`geared_motor_step.step`).

Warp takes the body of a function as C++. `traced_step` runs the formula on symbols that write each operation down, so
simulators on a GPU and the CPU share one formula. n motors are columns of a table and of a memory, as on the CPU; every
motor has its own position in the delay line, so each can be reset alone.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportInvalidTypeForm=false
# Warp is an optional dependency; no `annotations` from the future, as it reads those of kernels.

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from motorprior.actuator.geared_motor_step import (
    BASE_CONSTANTS,
    BASE_STATE,
    MAX_STIFFNESS,
    Arithmetic,
    MotorState,
    StepConstants,
    step,
)
from motorprior.actuator.grey_box import GreyBoxActuator, memory_rows, motor_table
from motorprior.actuator.optional_terms import REFERENCE
from motorprior.exceptions import ConfigError

MIN_STIFFNESS = 20.0  # minimum stiffness of a softened gear over kp: twist is at most 5 % of the position error
_REFERENCE = MotorState._fields.index(REFERENCE)
_TARGET, _LINE = len(MotorState._fields), len(MotorState._fields) + 1  # rows of the memory, as in `grey_box`
Rows, Row, Indices = wp.array2d(dtype=float), wp.array(dtype=float), wp.array(dtype=int)


def _operator(sign: str) -> "Callable[[Symbol, Any], Symbol]":
    return lambda own, other: own.new(f"{_text(own)} {sign} {_text(other)}")


def _swapped(sign: str) -> "Callable[[Symbol, Any], Symbol]":
    return lambda own, other: own.new(f"{_text(other)} {sign} {_text(own)}")


class Symbol:
    """A value of generated code; every operation writes a line."""

    def __init__(self, code: list[str], text: str):
        self.code, self.text = code, text

    def new(self, text: str) -> "Symbol":
        """A variable with this value."""
        self.code.append(f"const auto t{len(self.code)} = {text};")
        return Symbol(self.code, f"t{len(self.code) - 1}")

    __add__, __sub__, __mul__, __truediv__ = map(_operator, "+-*/")
    __radd__, __rsub__, __rmul__, __rtruediv__ = map(_swapped, "+-*/")
    __gt__, __lt__, __or__ = map(_operator, (">", "<", "||"))
    __neg__, __abs__ = (lambda own: own.new(f"-{own.text}")), (lambda own: own.new(f"wp::abs({own.text})"))


def _text(value: Any) -> str:
    return value.text if isinstance(value, Symbol) else f"{float(value)!r}f"


SYMBOLS = Arithmetic(
    where=lambda condition, yes, no: condition.new(f"{condition.text} ? {_text(yes)} : {_text(no)}"),
    indicator=lambda condition: condition.new(f"{condition.text} ? 1.0f : 0.0f"),
    clip=lambda x, limit: x.new(f"wp::min(wp::max({x.text}, -({_text(limit)})), {_text(limit)})"),
    positive_part=lambda x: x.new(f"{x.text} > 0.0f ? {x.text} : ({x.text} == {x.text} ? 0.0f : {x.text})"),
    with_sign_of=lambda x, other: x.new(f"wp::copysign({x.text}, {other.text})"),
    sqrt=lambda x: x.new(f"wp::sqrt({x.text})"),
)


def traced_step(terms: tuple[str, ...]) -> str:
    """C++ of one step of motor ``i`` of ``n``, from arrays table, memory and torque, damping."""
    constants = len(StepConstants._fields) if terms else BASE_CONSTANTS
    states = len(MotorState._fields) if terms else BASE_STATE
    code: list[str] = []
    new = Symbol(code, "").new
    p = StepConstants(*(new(f"table.data[{row} * n + i]") for row in range(constants)))
    state = MotorState(*(new(f"memory.data[{row} * n + i]") for row in range(states)))
    target, q, dq, h = (Symbol(code, name) for name in ("target", "q", "dq", "h"))
    state, torque, damping = step(p, state, target, q, dq, h, SYMBOLS, terms)
    code += [f"memory.data[{row} * n + i] = {_text(value)};" for row, value in enumerate(state[:states])]
    return "\n".join([*code, f"torque.data[i] = {_text(torque)};", f"damping.data[i] = {_text(damping)};"])


_DELAY_LINE = """
const int length = memory.shape[0] - {line};
const int newest = clock.data[i];
memory.data[({line} + newest) * n + i] = command;
const float age = table.data[{delay} * n + i] + 0.5f;
const int whole = (int)age;
const int first = newest >= whole ? newest - whole : newest - whole + length;
const int second = first > 0 ? first - 1 : length - 1;
const float newer = memory.data[({line} + first) * n + i];
const float target = newer + (age - (float)whole) * (memory.data[({line} + second) * n + i] - newer);
memory.data[{target} * n + i] = target;
clock.data[i] = newest + 1 < length ? newest + 1 : 0;
"""


@cache
def step_kernel(terms: tuple[str, ...]) -> wp.Kernel:
    """The kernel of a step of motors with these terms."""
    body = _DELAY_LINE.format(line=_LINE, target=_TARGET, delay=StepConstants._fields.index("delay"))

    @wp.func_native(f"const int n = table.shape[1];\n{body}\n{traced_step(terms)}")
    def motor_step(
        i: int, table: Rows, memory: Rows, clock: Indices, command: float, q: float, dq: float, h: float, torque: Row,
        damping: Row,
    ): ...  # fmt: skip

    @wp.kernel(module="unique")
    def motors_step(
        table: Rows, memory: Rows, clock: Indices, command: Row, joint_pos: Row, joint_vel: Row, h: float, torque: Row,
        damping: Row,
    ):  # fmt: skip
        i = wp.tid()
        motor_step(i, table, memory, clock, command[i], joint_pos[i], joint_vel[i], h, torque, damping)

    return motors_step


@wp.kernel
def motors_reset(
    bank: Rows, chosen: Indices, mask: wp.array(dtype=wp.bool), command: Row, joint_pos: Row, table: Rows, memory: Rows,
    clock: Indices, damping: Row,
):  # fmt: skip
    """Restart the motors that a mask selects."""
    i = wp.tid()
    if mask[i]:
        for row in range(table.shape[0]):
            table[row, i] = bank[row, chosen[i]]
        for row in range(wp.static(_LINE)):
            memory[row, i] = 0.0
        for row in range(wp.static(_LINE), memory.shape[0]):
            memory[row, i] = command[i]
        memory[0, i] = joint_pos[i]
        memory[wp.static(_REFERENCE), i] = command[i]
        clock[i] = 0
        damping[i] = 0.0


class WarpMotors:
    """n motors on a device of Warp. They start when `reset` has given each a column of the bank.

    Args:
        bank: motors that resets choose from.
        count: n.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the motors cannot be simulated at this step, see `require_gear`.
    """

    def __init__(self, bank: GreyBoxActuator, count: int, dt: float, device: str):
        require_gear(bank, dt)
        terms = bank.model.terms
        self._step, self._dt, self._device, self.count = step_kernel(terms), dt, device, count
        table = motor_table(bank.constants(), dt, terms).astype(np.float32)
        self._bank = wp.array(table, dtype=float, device=device)
        self.table = wp.zeros((len(table), count), dtype=float, device=device)
        self.memory = wp.zeros((memory_rows(dt), count), dtype=float, device=device)
        self.clock = wp.zeros(count, dtype=int, device=device)
        self.torque, self.damping = (wp.zeros(count, dtype=float, device=device) for _ in range(2))

    def reset(self, mask: Any, chosen: Any, command: Any, joint_pos: Any) -> None:
        """Restart the motors of a mask (n,) at rest at ``joint_pos`` [rad], as the columns ``chosen`` of the bank.

        ``command`` is the target before the first step [rad]. All are Warp arrays (n,).
        """
        inputs = [self._bank, chosen, mask, command, joint_pos, self.table, self.memory, self.clock, self.damping]
        wp.launch(motors_reset, dim=self.count, inputs=inputs, device=self._device)

    def step(self, command: Any, joint_pos: Any, joint_vel: Any) -> None:
        """Write ``torque`` [N·m] and ``damping`` [N·m·s/rad] for the coming physics step.

        The engine gets torque - damping·joint_vel, of which it integrates the damping implicitly, as for `Motors`.
        """
        arrays = [self.table, self.memory, self.clock, command, joint_pos, joint_vel, self._dt, self.torque]
        wp.launch(self._step, dim=self.count, inputs=[*arrays, self.damping], device=self._device)


def max_steps(motors: GreyBoxActuator) -> np.ndarray:
    """(n,) longest physics steps [s] that leave half of a gear's stiffness, or MIN_STIFFNESS·kp."""
    values = motors.constants()
    needed = np.minimum(0.5 * values["gear_stiffness"], MIN_STIFFNESS * values["kp"])
    return np.sqrt(MAX_STIFFNESS * values["armature"] / needed)


def require_gear(motors: GreyBoxActuator, dt: float) -> None:
    """Raise `ConfigError` if a physics step [s] is longer than one of `max_steps`."""
    max_dt, values = max_steps(motors), motors.constants()
    if dt > (limit := float(max_dt.min())):
        worst = int(max_dt.argmin())
        raise ConfigError(
            f"physics step {dt:g} s: the gear of {values['gear_stiffness'][worst]:.3g} N·m/rad on an armature of "
            f"{values['armature'][worst]:.2g} kg·m² needs at most {limit:.2g} s",
            remedy=f"use a step of {limit:.2g} s or less, with a larger decimation", argument="dt",
        )  # fmt: skip
