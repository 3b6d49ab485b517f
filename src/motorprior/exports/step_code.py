"""C++ of one step of geared motors in float32, traced from the formula of the compiled step.

`traced_step` runs the formula (`geared_motor_step.step`) on symbols that write each operation down,
so simulators on a GPU and on the CPU share one formula. The code needs arrays with ``data`` and
``shape``, and the functions ``min``, ``max``, ``abs``, ``copysign`` and ``sqrt`` of namespace
``wp``; Warp has both.
"""

from functools import partial
from typing import TypeAlias

from motorprior.actuator.command_frame import (
    FEEDFORWARD,
    KD_FACTOR,
    KP_FACTOR,
    QUANTITIES,
    VELOCITY_TARGET,
)
from motorprior.actuator.geared_motor_step import (
    BASE_CONSTANTS,
    BASE_STATE,
    Arithmetic,
    CommandFrame,
    MotorState,
    StepConstants,
    step,
)
from motorprior.actuator.grey_box import LINE, TARGET

# delay lines of a motor: its position target, then the quantities of `command_frame`
LINES = 1 + QUANTITIES
KP_LINE = 1 + KP_FACTOR
KD_LINE = 1 + KD_FACTOR


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


def step_code(terms: tuple[str, ...]) -> str:
    """C++ of one step of motor ``i`` with these terms.

    Its arrays are table, memory and clock (each motor has its own position in the delay lines),
    and torque and damping, which it writes. Its numbers are position_target, joint_pos, joint_vel,
    the step h, and the command frame: sent_velocity_target, sent_torque_feedforward,
    sent_kp_factor, sent_kd_factor.
    """
    return _DELAY_LINES + traced_step(terms)


def traced_step(terms: tuple[str, ...]) -> str:
    """C++ of the formula, from the delayed target and the frame in force."""
    num_constants = len(StepConstants._fields) if terms else BASE_CONSTANTS
    num_states = len(MotorState._fields) if terms else BASE_STATE
    code: list[str] = []
    new = Symbol(code, "").new

    # read the constants and the state
    constants = StepConstants(*(new(f"table.data[{row} * n + i]") for row in range(num_constants)))
    state = MotorState(*(new(f"memory.data[{row} * n + i]") for row in range(num_states)))

    target = Symbol(code, "target")
    q = Symbol(code, "joint_pos")
    dq = Symbol(code, "joint_vel")
    h = Symbol(code, "h")
    frame = CommandFrame(*(Symbol(code, name) for name in CommandFrame._fields))
    state, torque, damping = step(constants, state, target, q, dq, h, SYMBOLS, terms, frame)

    # write the state and the results
    for row, value in enumerate(state[:num_states]):
        code.append(f"memory.data[{row} * n + i] = {_text(value)};")
    code.append(f"torque.data[i] = {_text(torque)};")
    code.append(f"damping.data[i] = {_text(damping)};")
    return "\n".join(code)


def _mean_target(target: int, gain: int) -> str:
    """C++ of `command_frame.mean_target`, which replaces a delayed target whose gain changes."""
    return f"""if (newer[{gain}] != older[{gain}]) {{
    const float newer_gain = (1.0f - share) * newer[{gain}];
    const float older_gain = share * older[{gain}];
    const float gains = newer_gain + older_gain;
    if (gains != 0.0f)
        delayed[{target}] = (newer_gain * newer[{target}] + older_gain * older[{target}]) / gains;
}}"""


# the delay of `grey_box` and of `command_frame.delay_frames`
_DELAY_LINES = f"""
const int n = table.shape[1];
const int length = (memory.shape[0] - {LINE}) / {LINES};
const int newest = clock.data[i];
const float age = table.data[{StepConstants._fields.index("delay")} * n + i] + 0.5f;
const int whole = (int)age;
const int first = newest >= whole ? newest - whole : newest - whole + length;
const int second = first > 0 ? first - 1 : length - 1;
const float share = age - (float)whole;
const float sent[{LINES}] = {{
    position_target, sent_velocity_target, sent_torque_feedforward, sent_kp_factor, sent_kd_factor
}};
float newer[{LINES}];
float older[{LINES}];
float delayed[{LINES}];
for (int k = 0; k < {LINES}; ++k) {{
    const int line = {LINE} + k * length;
    memory.data[(line + newest) * n + i] = sent[k];
    newer[k] = memory.data[(line + first) * n + i];
    older[k] = memory.data[(line + second) * n + i];
    delayed[k] = newer[k] + share * (older[k] - newer[k]);
}}
{_mean_target(0, KP_LINE)}
{_mean_target(1 + VELOCITY_TARGET, KD_LINE)}
const float target = delayed[0];
const float velocity_target = delayed[{1 + VELOCITY_TARGET}];
const float torque_feedforward = delayed[{1 + FEEDFORWARD}];
const float kp_factor = delayed[{KP_LINE}];
const float kd_factor = delayed[{KD_LINE}];
memory.data[{TARGET} * n + i] = target;
clock.data[i] = newest + 1 < length ? newest + 1 : 0;
"""
