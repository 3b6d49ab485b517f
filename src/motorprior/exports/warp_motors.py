"""Geared motors as one Warp kernel in float32.

The kernel is traced from the formula of the compiled step (`geared_motor_step.step`). Warp takes
the body of a function as C++. `traced_step` runs the formula on symbols that write each operation
down, so simulators on a GPU and on the CPU share one formula.

n motors are columns of a table and of a memory, as on the CPU. Every motor has its own position in
the delay line, so that it can be reset alone.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportInvalidTypeForm=false
# Warp is an optional dependency.

from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np
import warp as wp

from motorprior.actuator.geared_motor_step import (
    BASE_CONSTANTS,
    BASE_STATE,
    MAX_STIFFNESS,
    Arithmetic,
    CommandFrame,
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
)
from motorprior.exceptions import ConfigError

# minimum stiffness of a softened gear over kp: twist is at most 5 % of the position error
MIN_STIFFNESS = 20.0

# arrays on a device
Rows = wp.array2d(dtype=float)
Row = wp.array(dtype=float)
Indices = wp.array(dtype=int)
Mask = wp.array(dtype=wp.bool)


class Symbol:
    """A value of generated code; every operation writes a line."""

    def __init__(self, code: list[str], text: str):
        self.code = code
        self.text = text

    def new(self, text: str) -> "Symbol":
        """A variable with this value."""
        name = f"t{len(self.code)}"
        self.code.append(f"const auto {name} = {text};")
        return Symbol(self.code, name)

    def __add__(self, right: "Operand") -> "Symbol":
        return _operation("{} + {}", self, right)

    def __radd__(self, left: "Operand") -> "Symbol":
        return _operation("{1} + {0}", self, left)

    def __sub__(self, right: "Operand") -> "Symbol":
        return _operation("{} - {}", self, right)

    def __rsub__(self, left: "Operand") -> "Symbol":
        return _operation("{1} - {0}", self, left)

    def __mul__(self, right: "Operand") -> "Symbol":
        return _operation("{} * {}", self, right)

    def __rmul__(self, left: "Operand") -> "Symbol":
        return _operation("{1} * {0}", self, left)

    def __truediv__(self, right: "Operand") -> "Symbol":
        return _operation("{} / {}", self, right)

    def __rtruediv__(self, left: "Operand") -> "Symbol":
        return _operation("{1} / {0}", self, left)

    def __gt__(self, right: "Operand") -> "Symbol":
        return _operation("{} > {}", self, right)

    def __lt__(self, right: "Operand") -> "Symbol":
        return _operation("{} < {}", self, right)

    def __or__(self, right: "Operand") -> "Symbol":
        return _operation("{} || {}", self, right)

    def __neg__(self) -> "Symbol":
        return _operation("-{}", self)

    def __abs__(self) -> "Symbol":
        return _operation("wp::abs({})", self)


Operand: TypeAlias = Symbol | float


def _operation(pattern: str, symbol: Symbol, *operands: Operand) -> Symbol:
    """A new variable with the value of an expression of a symbol and other operands."""
    return symbol.new(pattern.format(*map(_text, (symbol, *operands))))


def _text(operand: Operand) -> str:
    if isinstance(operand, Symbol):
        return operand.text
    return f"{float(operand)!r}f"


SYMBOLS = Arithmetic(
    where=partial(_operation, "{} ? {} : {}"),
    indicator=partial(_operation, "{} ? 1.0f : 0.0f"),
    clip=partial(_operation, "wp::min(wp::max({0}, -({1})), {1})"),
    positive_part=partial(_operation, "{0} > 0.0f ? {0} : ({0} == {0} ? 0.0f : {0})"),
    with_sign_of=partial(_operation, "wp::copysign({}, {})"),
    sqrt=partial(_operation, "wp::sqrt({})"),
)


def traced_step(terms: tuple[str, ...]) -> str:
    """C++ of one step of motor ``i`` of ``n``, from arrays table, memory, torque and damping."""
    num_constants = len(StepConstants._fields) if terms else BASE_CONSTANTS
    num_states = len(MotorState._fields) if terms else BASE_STATE
    code: list[str] = []
    new = Symbol(code, "").new

    # read the constants and the state
    constants = StepConstants(*(new(f"table.data[{row} * n + i]") for row in range(num_constants)))
    state = MotorState(*(new(f"memory.data[{row} * n + i]") for row in range(num_states)))

    target = Symbol(code, "target")
    q = Symbol(code, "q")
    dq = Symbol(code, "dq")
    h = Symbol(code, "h")
    frame = CommandFrame(Symbol(code, "velocity_target"), Symbol(code, "feedforward"), 1.0, 1.0)
    state, torque, damping = step(constants, state, target, q, dq, h, SYMBOLS, terms, frame)

    # write the state and the results
    for row, value in enumerate(state[:num_states]):
        code.append(f"memory.data[{row} * n + i] = {_text(value)};")
    code.append(f"torque.data[i] = {_text(torque)};")
    code.append(f"damping.data[i] = {_text(damping)};")
    return "\n".join(code)


# one line per quantity of a command: position target, velocity target, feed-forward torque
LINES = 3
_DELAY_LINE = f"""
const int n = table.shape[1];
const int length = (memory.shape[0] - {LINE}) / {LINES};
const int newest = clock.data[i];
const float age = table.data[{StepConstants._fields.index("delay")} * n + i] + 0.5f;
const int whole = (int)age;
const int first = newest >= whole ? newest - whole : newest - whole + length;
const int second = first > 0 ? first - 1 : length - 1;
const float share = age - (float)whole;
const float commands[{LINES}] = {{command, commanded_velocity, commanded_torque}};
float delayed[{LINES}];
for (int k = 0; k < {LINES}; ++k) {{
    const int line = {LINE} + k * length;
    memory.data[(line + newest) * n + i] = commands[k];
    const float newer = memory.data[(line + first) * n + i];
    const float older = memory.data[(line + second) * n + i];
    delayed[k] = newer + share * (older - newer);
}}
const float target = delayed[0];
const float velocity_target = delayed[1];
const float feedforward = delayed[2];
memory.data[{TARGET} * n + i] = target;
clock.data[i] = newest + 1 < length ? newest + 1 : 0;
"""


@cache
def step_kernel(terms: tuple[str, ...]) -> wp.Kernel:
    """The kernel of a step of motors with these terms."""

    # Warp replaces the body by the C++
    @wp.func_native(_DELAY_LINE + traced_step(terms))
    def motor_step(
        i: int,
        table: Rows,
        memory: Rows,
        clock: Indices,
        command: float,
        commanded_velocity: float,
        commanded_torque: float,
        q: float,
        dq: float,
        h: float,
        torque: Row,
        damping: Row,
    ): ...

    @wp.kernel(module="unique")
    def motors_step(
        samples: Rows,
        sample_index: Indices,
        waiting: Mask,
        table: Rows,
        memory: Rows,
        clock: Indices,
        command: Row,
        commanded_velocity: Row,
        commanded_torque: Row,
        joint_pos: Row,
        joint_vel: Row,
        h: float,
        torque: Row,
        damping: Row,
    ):
        i = wp.tid()

        # restart at rest, at the joint's angle
        if waiting[i]:
            waiting[i] = False
            clock[i] = 0
            for row in range(table.shape[0]):
                table[row, i] = samples[row, sample_index[i]]
            length = (memory.shape[0] - wp.static(LINE)) // wp.static(LINES)
            for row in range(memory.shape[0]):
                is_target = row >= wp.static(LINE) and row < wp.static(LINE) + length
                memory[row, i] = wp.where(is_target, joint_pos[i], 0.0)
            memory[0, i] = joint_pos[i]
            memory[wp.static(REFERENCE_ROW), i] = joint_pos[i]

        motor_step(
            i,
            table,
            memory,
            clock,
            command[i],
            commanded_velocity[i],
            commanded_torque[i],
            joint_pos[i],
            joint_vel[i],
            h,
            torque,
            damping,
        )

    return motors_step


class WarpMotors:
    """n motors on a device of Warp.

    To restart motors, set their elements of ``waiting`` (n,): they begin their next step at rest at
    its joint angle, as the columns ``sample_index`` (n,) of the samples. All motors wait at first.

    Args:
        samples: motors to choose from.
        count: n.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the physics step is longer than one of `max_steps`.
    """

    def __init__(self, samples: GreyBoxActuator, count: int, dt: float, device: str):
        _require_resolved(samples, dt)
        terms = samples.model.terms
        self.count = count
        self._step = step_kernel(terms)
        self._dt = dt
        self._device = device

        table = samples.table(dt).astype(np.float32)
        self._samples = wp.array(table, dtype=float, device=device)
        self.table = wp.zeros((len(table), count), dtype=float, device=device)
        rows = LINE + LINES * (memory_rows(dt) - LINE)
        self.memory = wp.zeros((rows, count), dtype=float, device=device)
        self._zeros = wp.zeros(count, dtype=float, device=device)
        self.clock = wp.zeros(count, dtype=int, device=device)
        self.torque = wp.zeros(count, dtype=float, device=device)
        self.damping = wp.zeros(count, dtype=float, device=device)

        self.waiting = wp.full(count, True, dtype=wp.bool, device=device)
        first_samples = np.arange(count) % samples.num_motors
        self.sample_index = wp.array(first_samples, dtype=int, device=device)

    def step(
        self,
        command: Any,
        joint_pos: Any,
        joint_vel: Any,
        velocity_target: Any = None,
        torque_feedforward: Any = None,
    ) -> None:
        """Write ``torque`` [N·m] and ``damping`` [N·m·s/rad] for the coming physics step.

        Arguments are Warp arrays (n,); velocity target and feed-forward torque are 0 if not given.
        The engine gets torque - damping·joint_vel, of which it
        integrates the damping implicitly, as for `Motors`.
        """
        inputs = [
            self._samples,
            self.sample_index,
            self.waiting,
            self.table,
            self.memory,
            self.clock,
            command,
            self._zeros if velocity_target is None else velocity_target,
            self._zeros if torque_feedforward is None else torque_feedforward,
            joint_pos,
            joint_vel,
            self._dt,
            self.torque,
            self.damping,
        ]
        wp.launch(self._step, dim=self.count, inputs=inputs, device=self._device)


def max_steps(motors: GreyBoxActuator) -> np.ndarray:
    """(n,) longest physics steps [s] that leave half of a gear's stiffness, or MIN_STIFFNESS·kp."""
    values = motors.constants()
    needed = np.minimum(0.5 * values["gear_stiffness"], MIN_STIFFNESS * values["kp"])
    return np.sqrt(MAX_STIFFNESS * values["armature"] / needed)


def _require_resolved(motors: GreyBoxActuator, dt: float) -> None:
    """Raise ConfigError if a physics step [s] is too long for one of the gears."""
    limits = max_steps(motors)
    worst = int(limits.argmin())
    limit = float(limits[worst])
    if dt <= limit:
        return
    values = motors.constants()
    raise ConfigError(
        f"physics step {dt:g} s: the gear of {values['gear_stiffness'][worst]:.3g} N·m/rad on an "
        f"armature of {values['armature'][worst]:.2g} kg·m² needs at most {limit:.2g} s",
        remedy=f"use a step of {limit:.2g} s or less, with a larger decimation",
        argument="dt",
    )
