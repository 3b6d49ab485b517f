"""Optional dynamics terms of geared motors (`geared_motor_step`).

Each term is enabled or disabled for a whole motor prior. All quantities are at the output shaft; h
is the step. The terms act in this order:

    profile        trapezoidal profile of the firmware: the velocity of the reference approaches
                   w = sign(d)·min(profile_speed, √(c² + 2·profile_acceleration·|d|) - c, |d|/h) by
                   at most profile_acceleration·h, with d = target - reference and
                   c = h·profile_acceleration/2. The reference replaces the target. (Dynamixel,
                   Feetech: profile velocity, profile acceleration, goal speed)
    output_encoder the encoder is on the joint instead of the rotor. In gear contact the joint is
                   assumed to accelerate like the rotor, so that the control law is as implicit as
                   with an encoder on the rotor.
    dead_zone      error e → e - clip(e, ±dead_zone)  (Feetech STS: CW/CCW dead zone)
    integral       the control law adds the torque I:
                   I' = clip(I + h·kp·integral_rate·e, ±integral_limit)
    torque_speed   voltage limit: when driving,
                   |torque of the control law| <= stall_torque·(1 - v/no_load_speed)
    current        the motor torque τ follows the torque of the control law with a lag:
                   τ' = τ + (1 - exp(-h/current_time))·(torque of the control law - τ)
    asymmetry      dry friction F → F·(1 + asymmetry·sign(v))
    presliding     dry friction is the torque σ·z of a bristle with deflection z, at most F:
                   z' = z + h·v' until σ·|z| = F. A static rotor yields before it breaks away.
                   (Dahl, 1968; elasto-plastic limit of LuGre, Dupont et al., 2002)
    angle_friction dry friction F → F·max(1 + friction_slope·rotor_pos, MIN_FRICTION_SHARE), as of a
                   joint behind a linkage
    output_damping viscous damping of the joint, output_damping·dq, which the engine integrates
    heat           torques of the control law are scaled by (1 - heat_loss·warmth), with
                   warmth = 1 - exp(-t/heat_time) at time t of the log. The warmth is 0.5 if the
                   time is unknown.
    supply         with s = supply voltage / nominal voltage, torques of the control law are scaled
                   by (1 + supply_share·(s - 1)), and no-load speed and stall torque by s.
                   supply_share is 1 if the control law commands the duty cycle of the bridge (most
                   hobby servos), and 0 if it commands the current.
    temperature    torques of the control law are scaled by
                   (1 - temperature_loss·(T - T_nominal)/50 K)

The nominal voltage and temperature are medians over the logs that a prior was trained on; they are
the default. To add a term, add an entry to TERMS. A term with the function ``law`` changes the
torque of the control law; any other term needs a line in `geared_motor_step.step` or
`at_operating_conditions`.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

MIN_FRICTION_SHARE = 0.1  # smallest factor of the term angle_friction [-]
MAX_SHARE = 0.9  # maximum asymmetry, and maximum torque loss by heat, supply or temperature [-]


class TermConstant(NamedTuple):
    """A constant of a term."""

    name: str
    unit: str
    initial: float  # value at the start of a search
    # value with almost no effect; a second search starts from it
    negligible: float
    # value without any effect; None for a constant that changes other constants, not the step
    disabled: float | None = None
    # value per unit of decoder output of a constant that may be negative; 0 for other constants,
    # which are exp(output)
    signed: float = 0.0
    max: float = 0.0  # bound of the magnitude; 0 if there is no bound
    # whether this is a time constant X_time, for which `StepConstants` has X_gain and mean_X_gain
    is_lag: bool = False
    # value if the log states that the limit is switched off; it fits in float32
    unlimited: float = 0.0

    @property
    def rows(self) -> tuple[str, ...]:
        """Names in `StepConstants`."""
        if self.disabled is None:
            return ()
        lag = self.name.removesuffix("_time")
        return (f"{lag}_gain", f"mean_{lag}_gain") if self.is_lag else (self.name,)


class Term(NamedTuple):
    """An optional term.

    A term without constants has a row of its own name in `StepConstants`, which is 1 if the term is
    enabled, and 0 otherwise.
    """

    constants: tuple[TermConstant, ...] = ()
    # rows of `MotorState`; REFERENCE starts at the target, the other rows start at 0
    state: tuple[str, ...] = ()
    is_usual: bool = False  # whether hobby servos usually have it
    # whether it acts only in fast motions: a limit of speed, acceleration or torque
    is_limit: bool = False
    # whether it belongs to the mechanism of a joint instead of the model of its motor: a class of
    # joints may have it alone
    is_of_joint: bool = False
    # (constants, torque of the control law [N·m], rotor velocity [rad/s], arithmetic) -> changed
    # torque
    law: Callable[[Any, Any, Any, Any], Any] | None = None


REFERENCE = "reference"
TERMS = {
    "profile": Term(
        (
            TermConstant("profile_speed", "rad/s", 6.0, 40.0, 1e9, unlimited=1e3),
            TermConstant("profile_acceleration", "rad/s²", 100.0, 4000.0, 1e12, unlimited=1e5),
        ),
        (REFERENCE, "reference_vel"),
        is_usual=True,
        is_limit=True,
    ),
    "output_encoder": Term(is_usual=True),
    "dead_zone": Term((TermConstant("dead_zone", "rad", 0.003, 1e-4, 0.0),), is_usual=True),
    "integral": Term(
        (
            TermConstant("integral_rate", "1/s", 2.0, 0.05, 0.0),
            TermConstant("integral_limit", "N·m", 0.3, 0.05, 0.0),
        ),
        ("integral",),
    ),
    "torque_speed": Term(
        (
            TermConstant("stall_torque", "N·m", 3.0, 20.0, 1e9),
            TermConstant("no_load_speed", "rad/s", 10.0, 100.0, 1e9),
        ),
        is_limit=True,
    ),
    "current": Term(
        (TermConstant("current_time", "s", 0.003, 3e-4, 1e-12, is_lag=True),), ("current",)
    ),
    "asymmetry": Term((TermConstant("asymmetry", "1", 0.0, 0.0, 0.0, signed=0.2, max=MAX_SHARE),)),
    "presliding": Term(
        (TermConstant("bristle_stiffness", "N·m/rad", 10.0, 200.0, 1e9),), ("bristle",)
    ),
    "output_damping": Term(
        (TermConstant("output_damping", "N·m·s/rad", 0.005, 1e-4, 0.0),), is_usual=True
    ),
    "heat": Term(
        (
            TermConstant("heat_loss", "1", 0.1, 0.01, max=MAX_SHARE),
            TermConstant("heat_time", "s", 10.0, 10.0),
        )
    ),
    "supply": Term((TermConstant("supply_share", "1", 0.7, 0.1),)),
    "temperature": Term((TermConstant("temperature_loss", "1", 0.0, 0.0, signed=0.1),)),
    "angle_friction": Term(
        (TermConstant("friction_slope", "1/rad", 0.0, 0.0, 0.0, signed=0.2),), is_of_joint=True
    ),
}


def rows_of(name: str) -> tuple[str, ...]:
    """Names in `StepConstants` of the rows of a term."""
    constants = TERMS[name].constants
    return tuple(row for constant in constants for row in constant.rows) if constants else (name,)


CONSTANTS = {constant.name: constant for term in TERMS.values() for constant in term.constants}
INITIAL = {name: constant.initial for name, constant in CONSTANTS.items()}
NEGLIGIBLE = {name: constant.negligible for name, constant in CONSTANTS.items()}
UNLIMITED = {name: constant.unlimited for name, constant in CONSTANTS.items() if constant.unlimited}
# rows of `StepConstants` and of `MotorState` that motors have if any of their terms is enabled
STEP_ROWS = tuple(row for name in TERMS for row in rows_of(name))
STATE_ROWS = tuple(row for term in TERMS.values() for row in term.state)
# constants that may be negative, and their value per unit of decoder output
SIGNED = {"encoder_zero": 0.05} | {
    name: constant.signed for name, constant in CONSTANTS.items() if constant.signed
}
# constants that scale with the torques of the control law
_SCALED_BY_LAW = ("kp", "torque_limit", "integral_limit", "feedforward_gain")
_SCALE_OF_TORQUES = ("heat_loss", "supply_share", "temperature_loss")
# constants that scale with the field of the magnets
_SCALED_BY_MAGNETS = (*_SCALED_BY_LAW, "stall_torque")
# constants that scale with the supply voltage
_SCALED_BY_VOLTAGE = ("stall_torque", "no_load_speed")
TEMPERATURE_SCALE = 50.0  # temperature rise at which the torque loss is temperature_loss [K]


class OperatingConditions(NamedTuple):
    """Operating conditions, per motor or the same for all."""

    warmth: Any = 0.0  # state of the term heat, from 0 (cold) to 1
    supply: Any = 1.0  # supply voltage / nominal voltage [-]
    temperature_rise: Any = 0.0  # temperature above the nominal one [K]


# Both have nominal voltage and temperature. COLD is the start of operation, HALF_WARM stands for an
# unknown time of operation.
COLD = OperatingConditions()
HALF_WARM = OperatingConditions(warmth=0.5)


def at_operating_conditions(
    operating_conditions: OperatingConditions, values: dict[str, Any]
) -> dict[str, Any]:
    """Constants by name at these operating conditions.

    If they change torques, ``feedforward_gain`` is the factor on feed-forward torques.
    """
    if any(name in values for name in _SCALE_OF_TORQUES):
        values = values | {"feedforward_gain": np.ones_like(values["kp"])}
    if "heat_loss" in values:
        factor = 1.0 - values["heat_loss"] * operating_conditions.warmth
        values = _scaled(factor, values, _SCALED_BY_MAGNETS)
    if "supply_share" in values:
        factor = 1.0 + values["supply_share"] * (operating_conditions.supply - 1.0)
        values = _scaled(np.maximum(factor, 1.0 - MAX_SHARE), values, _SCALED_BY_LAW)
        values = _scaled(operating_conditions.supply, values, _SCALED_BY_VOLTAGE)
    if "temperature_loss" in values:
        temperature_rise = operating_conditions.temperature_rise
        factor = 1.0 - values["temperature_loss"] * temperature_rise / TEMPERATURE_SCALE
        values = _scaled(np.maximum(factor, 1.0 - MAX_SHARE), values, _SCALED_BY_MAGNETS)
    return values


def _scaled(factor: Any, values: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return values | {name: factor * values[name] for name in names if name in values}


def constants_of(terms: Iterable[str]) -> tuple[str, ...]:
    """Names of the constants of these terms."""
    return tuple(constant.name for term in terms for constant in TERMS[term].constants)


def terms_with(constants: Iterable[str]) -> tuple[str, ...]:
    """The terms with any of these constants, in the order of TERMS.

    A term without constants counts as its own constant, which is 1 or 0.
    """
    names = set(constants)
    return tuple(term for term in TERMS if names.intersection(constants_or_name(term)))


def constants_or_name(term: str) -> tuple[str, ...]:
    """Names of the constants of a term; its own name if it has none."""
    return constants_of((term,)) or (term,)


def in_order(terms: Iterable[str]) -> tuple[str, ...]:
    """The terms in the order of TERMS."""
    names = set(terms)
    return tuple(name for name in TERMS if name in names)


def step_rows(
    terms: tuple[str, ...], values: dict[str, Any], h: float, zero: Any
) -> dict[str, Any]:
    """Rows of all optional terms in `StepConstants`, by name, for steps of ``h`` [s].

    The rows of terms that are not in ``terms`` have values without effect.
    """
    rows = {}
    for name, term in TERMS.items():
        if not term.constants:
            rows[name] = zero + (name in terms)
        for constant in term.constants:
            value = values.get(constant.name, zero + (constant.disabled or 0.0))
            if constant.is_lag:
                step_over_lag = h / value
                gain_row, mean_gain_row = constant.rows
                rows[gain_row] = -np.expm1(-step_over_lag)
                rows[mean_gain_row] = 1.0 + np.expm1(-step_over_lag) / step_over_lag
            elif constant.rows:
                rows[constant.name] = value
    return rows


def smaller(a: Any, b: Any, arithmetic: Any) -> Any:
    """min(a, b), lane by lane."""
    return a - arithmetic.positive_part(a - b)


def profiled(p: Any, state: Any, target: Any, h: Any, arithmetic: Any) -> Any:
    """The state with the reference moved towards the target for one step."""
    difference = target - state.reference
    distance = abs(difference)

    # Speed from which whole steps can brake to the target; ``half_change`` is the change of speed
    # in half a step.
    half_change = 0.5 * h * p.profile_acceleration
    square = half_change * half_change + 2.0 * p.profile_acceleration * distance
    braking_speed = arithmetic.sqrt(square) - half_change
    max_speed = smaller(p.profile_speed, braking_speed, arithmetic)
    speed = smaller(max_speed, distance / h, arithmetic)

    vel_change = arithmetic.with_sign_of(speed, difference) - state.reference_vel
    velocity = state.reference_vel + arithmetic.clip(vel_change, 2.0 * half_change)
    return state._replace(reference=state.reference + h * velocity, reference_vel=velocity)


def at_angle(p: Any, friction: Any, rotor_pos: Any, arithmetic: Any) -> Any:
    """Dry friction at this angle of the rotor."""
    share_above_minimum = 1.0 - MIN_FRICTION_SHARE + p.friction_slope * rotor_pos
    return friction * (MIN_FRICTION_SHARE + arithmetic.positive_part(share_above_minimum))


def within_voltage(p: Any, law_torque: Any, v: Any, arithmetic: Any) -> Any:
    """Torque of the control law within the voltage limit at rotor velocity v."""
    speed_ratio = v / p.no_load_speed
    max_torque = arithmetic.positive_part(p.stall_torque * (1.0 - speed_ratio))
    max_negative_torque = arithmetic.positive_part(p.stall_torque * (1.0 + speed_ratio))
    torque = smaller(law_torque, max_torque, arithmetic)
    return torque + arithmetic.positive_part(-torque - max_negative_torque)
