"""Geared motors as one Warp kernel in float32, traced from the formula of the compiled step (`geared_motor_step.step`).

Warp takes the body of a function as C++. `traced_step` runs the formula on symbols that write each
operation down, so simulators on a GPU and the CPU share one formula. n motors are columns of a
table and of a memory, as on the CPU; every motor has its own position in the delay line, so each
can be reset alone.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportInvalidTypeForm=false
# Warp is an optional dependency.

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
from motorprior.actuator.grey_box import (
    LINE,
    REFERENCE_ROW,
    TARGET,
    GreyBoxActuator,
    memory_rows,
    motor_table,
)
from motorprior.exceptions import ConfigError

# minimum stiffness of a softened gear over kp: twist is at most 5 % of the position error
MIN_STIFFNESS = 20.0
Rows = wp.array2d(dtype=float)
Row = wp.array(dtype=float)
Indices = wp.array(dtype=int)
Mask = wp.array(dtype=wp.bool)


def _text(value: Any) -> str:
    return value.text if isinstance(value, Symbol) else f"{float(value)!r}f"


def _written(pattern: str) -> "Callable[..., Symbol]":
    """An operation on symbols and numbers, the first of which is a symbol."""
    return lambda own, *others: own.new(pattern.format(*map(_text, (own, *others))))


class Symbol:
    """A value of generated code; every operation writes a line."""

    def __init__(self, code: list[str], text: str):
        self.code = code
        self.text = text

    def new(self, text: str) -> "Symbol":
        """A variable with this value."""
        self.code.append(f"const auto t{len(self.code)} = {text};")
        return Symbol(self.code, f"t{len(self.code) - 1}")

    __add__, __sub__, __mul__, __truediv__ = (_written(f"{{}} {sign} {{}}") for sign in "+-*/")
    __radd__, __rsub__, __rmul__, __rtruediv__ = (
        _written(f"{{1}} {sign} {{0}}") for sign in "+-*/"
    )
    __gt__, __lt__, __or__ = map(_written, ("{} > {}", "{} < {}", "{} || {}"))
    __neg__, __abs__ = map(_written, ("-{}", "wp::abs({})"))


SYMBOLS = Arithmetic(
    where=_written("{} ? {} : {}"),
    indicator=_written("{} ? 1.0f : 0.0f"),
    clip=_written("wp::min(wp::max({0}, -({1})), {1})"),
    positive_part=_written("{0} > 0.0f ? {0} : ({0} == {0} ? 0.0f : {0})"),
    with_sign_of=_written("wp::copysign({}, {})"),
    sqrt=_written("wp::sqrt({})"),
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
    code += [
        f"memory.data[{row} * n + i] = {_text(value)};" for row, value in enumerate(state[:states])
    ]
    return "\n".join(
        [*code, f"torque.data[i] = {_text(torque)};", f"damping.data[i] = {_text(damping)};"]
    )


_DELAY_LINE = f"""
const int n = table.shape[1];
const int length = memory.shape[0] - {LINE};
const int newest = clock.data[i];
memory.data[({LINE} + newest) * n + i] = command;
const float age = table.data[{StepConstants._fields.index("delay")} * n + i] + 0.5f;
const int whole = (int)age;
const int first = newest >= whole ? newest - whole : newest - whole + length;
const int second = first > 0 ? first - 1 : length - 1;
const float newer = memory.data[({LINE} + first) * n + i];
const float target = newer + (age - (float)whole) * (memory.data[({LINE} + second) * n + i] - newer);
memory.data[{TARGET} * n + i] = target;
clock.data[i] = newest + 1 < length ? newest + 1 : 0;
"""


@cache
def step_kernel(terms: tuple[str, ...]) -> wp.Kernel:
    """The kernel of a step of motors with these terms."""

    @wp.func_native(_DELAY_LINE + traced_step(terms))
    def motor_step(
        i: int,
        table: Rows,
        memory: Rows,
        clock: Indices,
        command: float,
        q: float,
        dq: float,
        h: float,
        torque: Row,
        damping: Row,
    ): ...

    @wp.kernel(module="unique")
    def motors_step(
        bank: Rows,
        chosen: Indices,
        waiting: Mask,
        table: Rows,
        memory: Rows,
        clock: Indices,
        command: Row,
        joint_pos: Row,
        joint_vel: Row,
        h: float,
        torque: Row,
        damping: Row,
    ):
        i = wp.tid()
        if waiting[i]:
            waiting[i] = False
            clock[i] = 0
            for row in range(table.shape[0]):
                table[row, i] = bank[row, chosen[i]]
            for row in range(memory.shape[0]):
                memory[row, i] = wp.where(row < wp.static(LINE), 0.0, joint_pos[i])
            memory[0, i] = joint_pos[i]
            memory[wp.static(REFERENCE_ROW), i] = joint_pos[i]
        motor_step(
            i, table, memory, clock, command[i], joint_pos[i], joint_vel[i], h, torque, damping
        )

    return motors_step


class WarpMotors:
    """n motors on a device of Warp.

    To restart motors, set their elements of ``waiting`` (n,): they begin their next step at rest at
    its joint angle, as the columns ``chosen`` (n,) of the bank. All wait at first.

    Args:
        bank: motors to choose from.
        count: n.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the physics step is longer than one of `max_steps`.
    """

    def __init__(self, bank: GreyBoxActuator, count: int, dt: float, device: str):
        values = bank.constants()
        limits = max_steps(bank)
        terms = bank.model.terms
        if dt > (limit := float(limits.min())):
            worst = int(limits.argmin())
            raise ConfigError(
                f"physics step {dt:g} s: the gear of {values['gear_stiffness'][worst]:.3g} N·m/rad on an armature of "
                f"{values['armature'][worst]:.2g} kg·m² needs at most {limit:.2g} s",
                remedy=f"use a step of {limit:.2g} s or less, with a larger decimation",
                argument="dt",
            )
        self._step = step_kernel(terms)
        self._dt = dt
        self._device = device
        self.count = count
        table = motor_table(values, dt, terms).astype(np.float32)
        self._bank = wp.array(table, dtype=float, device=device)
        self.table = wp.zeros((len(table), count), dtype=float, device=device)
        self.memory = wp.zeros((memory_rows(dt), count), dtype=float, device=device)
        self.clock = wp.zeros(count, dtype=int, device=device)
        self.torque, self.damping = (wp.zeros(count, dtype=float, device=device) for _ in range(2))
        self.waiting = wp.full(count, True, dtype=wp.bool, device=device)
        self.chosen = wp.array(np.arange(count) % bank.num_motors, dtype=int, device=device)

    def step(self, command: Any, joint_pos: Any, joint_vel: Any) -> None:
        """Write ``torque`` [N·m] and ``damping`` [N·m·s/rad] for the coming physics step, from Warp arrays (n,).

        The engine gets torque - damping·joint_vel, of which it integrates the damping implicitly,
        as for `Motors`.
        """
        own = [self._bank, self.chosen, self.waiting, self.table, self.memory, self.clock]
        inputs = [*own, command, joint_pos, joint_vel, self._dt, self.torque, self.damping]
        wp.launch(self._step, dim=self.count, inputs=inputs, device=self._device)


def max_steps(motors: GreyBoxActuator) -> np.ndarray:
    """(n,) longest physics steps [s] that leave half of a gear's stiffness, or MIN_STIFFNESS·kp."""
    values = motors.constants()
    needed = np.minimum(0.5 * values["gear_stiffness"], MIN_STIFFNESS * values["kp"])
    return np.sqrt(MAX_STIFFNESS * values["armature"] / needed)
