"""Geared motors as one Warp kernel in float32, traced from the formula of the compiled step (`geared_motor_step.step`).

Warp takes the body of a function as C++. `traced_step` runs the formula on symbols that write each operation down, so
simulators on a GPU and the CPU share one formula. n motors are columns of a table and of a memory, as on the CPU; every
motor has its own position in the delay line, so each can be reset alone.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportInvalidTypeForm=false
# Warp is an optional dependency.
from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from motorprior.actuator.geared_motor import memory_rows, motor_table
from motorprior.actuator.geared_motor_step import (
    BASE_CONSTANTS,
    BASE_STATE,
    MAX_STIFFNESS,
    Arithmetic,
    MotorState,
    StepConstants,
    step,
)
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.optional_terms import REFERENCE
from motorprior.exceptions import ConfigError

_REFERENCE = MotorState._fields.index(REFERENCE)
_TARGET, _LINE = len(MotorState._fields), len(MotorState._fields) + 1  # rows of the memory, as in `geared_motor`


class Symbol:
    """A float of generated code; every operation writes a line."""

    def __init__(self, code: list[str], text: str):
        self.code, self.text = code, text

    def new(self, text: str, kind: str = "float") -> Symbol:
        """A variable with this value."""
        name = f"t{len(self.code)}"
        self.code.append(f"{kind} {name} = {text};")
        return Symbol(self.code, name)

    def _binary(self, sign: str, other: Any, swapped: bool = False, kind: str = "float") -> Symbol:
        left, right = (_text(other), self.text) if swapped else (self.text, _text(other))
        return self.new(f"{left} {sign} {right}", kind)

    def __add__(self, other: Any) -> Symbol:
        return self._binary("+", other)

    def __radd__(self, other: Any) -> Symbol:
        return self._binary("+", other, True)

    def __sub__(self, other: Any) -> Symbol:
        return self._binary("-", other)

    def __rsub__(self, other: Any) -> Symbol:
        return self._binary("-", other, True)

    def __mul__(self, other: Any) -> Symbol:
        return self._binary("*", other)

    def __rmul__(self, other: Any) -> Symbol:
        return self._binary("*", other, True)

    def __truediv__(self, other: Any) -> Symbol:
        return self._binary("/", other)

    def __rtruediv__(self, other: Any) -> Symbol:
        return self._binary("/", other, True)

    def __gt__(self, other: Any) -> Symbol:
        return self._binary(">", other, kind="bool")

    def __lt__(self, other: Any) -> Symbol:
        return self._binary("<", other, kind="bool")

    def __or__(self, other: Any) -> Symbol:
        return self._binary("||", other, kind="bool")

    def __neg__(self) -> Symbol:
        return self.new(f"-{self.text}")

    def __abs__(self) -> Symbol:
        return self.new(f"wp::abs({self.text})")


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
    root = Symbol(code, "")
    p = StepConstants(*(root.new(f"table.data[{row} * n + i]") for row in range(constants)))
    state = MotorState(*(root.new(f"memory.data[{row} * n + i]") for row in range(states)))
    inputs = [Symbol(code, name) for name in ("target", "q", "dq", "h")]
    state, torque, damping = step(p, state, inputs[0], inputs[1], inputs[2], inputs[3], SYMBOLS, terms)
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
def motor_kernels(terms: tuple[str, ...]) -> tuple[Any, Any]:
    """Warp kernels of motors with these terms: a step, and a reset of the motors that a mask selects."""
    import warp as wp

    body = _DELAY_LINE.format(line=_LINE, target=_TARGET, delay=StepConstants._fields.index("delay"))
    snippet = f"const int n = table.shape[1];\n{body}\n{traced_step(terms)}"

    # Warp reads types from annotations, which would be text here: they are set on the functions
    rows, row, ints = wp.array2d(dtype=float), wp.array(dtype=float), wp.array(dtype=int)
    arrays = dict(table=rows, memory=rows, clock=ints)

    def motor_step(i, table, memory, clock, command, q, dq, h, torque, damping): ...

    motor_step.__annotations__ = dict(
        i=int, **arrays, command=float, q=float, dq=float, h=float, torque=row, damping=row
    )
    native = wp.func_native(snippet)(motor_step)
    reference, line = wp.constant(_REFERENCE), wp.constant(_LINE)

    def step_kernel(table, memory, clock, command, joint_pos, joint_vel, h, torque, damping):
        i = wp.tid()
        native(i, table, memory, clock, command[i], joint_pos[i], joint_vel[i], h, torque, damping)

    def reset_kernel(bank, chosen, mask, command, joint_pos, table, memory, clock, damping):
        i = wp.tid()
        if mask[i]:
            for row in range(table.shape[0]):
                table[row, i] = bank[row, chosen[i]]
            for row in range(line):
                memory[row, i] = 0.0
            memory[0, i] = joint_pos[i]
            memory[reference, i] = command[i]
            for row in range(line, memory.shape[0]):
                memory[row, i] = command[i]
            clock[i] = 0
            damping[i] = 0.0

    step_kernel.__annotations__ = dict(
        **arrays, command=row, joint_pos=row, joint_vel=row, h=float, torque=row, damping=row
    )
    reset_kernel.__annotations__ = dict(
        bank=rows, chosen=ints, mask=wp.array(dtype=wp.bool), command=row, joint_pos=row, **arrays, damping=row
    )
    suffix = "_".join(terms) or "base"
    module = wp.get_module(f"{__name__}.{suffix}")
    return (
        wp.Kernel(step_kernel, key=f"motor_step_{suffix}", module=module),
        wp.Kernel(reset_kernel, key=f"motor_reset_{suffix}", module=module),
    )


class WarpMotors:
    """n motors on a device of Warp. They start when `reset` has given each a column of the bank.

    Args:
        bank: motors that resets choose from.
        count: n.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the motors cannot be simulated at this step, or `require_gear`.
    """

    def __init__(self, bank: GreyBoxActuator, count: int, dt: float, device: str):
        import warp as wp

        require_gear(bank, dt)
        self._launch, self._dt, self._device, self.count = wp.launch, dt, device, count
        terms = bank.model.motor.terms
        self._step, self._reset = motor_kernels(terms)
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
        self._launch(self._reset, dim=self.count, inputs=inputs, device=self._device)

    def step(self, command: Any, joint_pos: Any, joint_vel: Any) -> None:
        """Write ``torque`` [N·m] and ``damping`` [N·m·s/rad] for the coming physics step.

        The engine gets torque - damping·joint_vel, of which it integrates the damping implicitly, as for `Motors`.
        """
        arrays = [self.table, self.memory, self.clock, command, joint_pos, joint_vel, self._dt, self.torque]
        self._launch(self._step, dim=self.count, inputs=[*arrays, self.damping], device=self._device)


def require_gear(motors: GreyBoxActuator, dt: float) -> None:
    """Raise `ConfigError` if a physics step [s] would soften a gear to less than half of its stiffness."""
    values = motors.constants()
    longest = np.sqrt(2.0 * MAX_STIFFNESS * values["armature"] / values["gear_stiffness"])
    if dt > (limit := float(longest.min())):
        worst = int(longest.argmin())
        raise ConfigError(
            f"physics step {dt:g} s: the gear of {values['gear_stiffness'][worst]:.3g} N·m/rad on an armature of "
            f"{values['armature'][worst]:.2g} kg·m² needs at most {limit:.2g} s",
            remedy=f"use a step of {limit:.2g} s or less, with a larger decimation", argument="dt",
        )  # fmt: skip
