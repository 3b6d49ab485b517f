"""Optional dynamics terms of geared motors (`geared_motor_step`), each enabled or disabled for a whole motor prior.

All quantities are at the output shaft; h is the step. In the order in which they act:

    profile        trapezoidal profile of the firmware: the velocity of the reference approaches
                   w = sign(d)·min(profile_speed, √(c² + 2·profile_acceleration·|d|) - c, |d|/h) by at most
                   profile_acceleration·h, with d = target - reference, c = h·profile_acceleration/2. The reference
                   replaces the target. (Dynamixel, Feetech: profile velocity, profile acceleration, goal speed)
    output_encoder the encoder is on the joint instead of the rotor. In gear contact the joint is assumed to accelerate
                   like the rotor, so that the law is as implicit as with an encoder on the rotor.
    dead_zone      error e → e - clip(e, ±dead_zone)                                    (Feetech STS: CW/CCW dead zone)
    integral       the law gets an additional torque I:  I' = clip(I + h·kp·integral_rate·e, ±integral_limit)
    torque_speed   |torque of the law| <= stall_torque·(1 - v/no_load_speed) in the driving direction (voltage limit)
    current        the law's torque reaches the rotor through a lag:  τ' = τ + (1 - exp(-h/current_time))·(law - τ)
    asymmetry      dry friction F → F·(1 + asymmetry·sign(v))
    presliding     dry friction is the force σ·z of a bristle, at most F:  z' = z + h·v' until σ·|z| = F. A static rotor
                   yields before it breaks away. (Dahl, 1968; elasto-plastic limit of LuGre, Dupont et al., 2002)
    output_damping viscous damping of the joint, output_damping·dq, which the engine integrates
    heat           torques of the law are scaled by (1 - heat_loss·warmth), warmth = 1 - exp(-t/heat_time) at time t of
                   the log, and 0.5 where the time is unknown
    supply         torques of the law are scaled by (1 + supply_share·(s - 1)), no-load speed and stall torque by s =
                   supply voltage / nominal voltage. supply_share is 1 if the law commands the duty cycle of the
                   bridge (most hobby servos), 0 if it commands the current.
    temperature    torques of the law are scaled by (1 - temperature_loss·(T - T_nominal)/50 K)

Nominal values are the medians of the logs that a prior was trained on, and the default.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

# Constants of each term, in SI units: profile_speed [rad/s], profile_acceleration [rad/s²], dead_zone [rad],
# integral_rate [1/s], integral_limit and stall_torque [N·m], no_load_speed [rad/s], current_time [s], asymmetry
# [-], bristle_stiffness σ [N·m/rad], output_damping [N·m·s/rad], heat_loss [-], heat_time [s], supply_share [-],
# temperature_loss [-]
TERMS: dict[str, tuple[str, ...]] = {
    "profile": ("profile_speed", "profile_acceleration"),
    "output_encoder": (),
    "dead_zone": ("dead_zone",),
    "integral": ("integral_rate", "integral_limit"),
    "torque_speed": ("stall_torque", "no_load_speed"),
    "current": ("current_time",),
    "asymmetry": ("asymmetry",),
    "presliding": ("bristle_stiffness",),
    "output_damping": ("output_damping",),
    "heat": ("heat_loss", "heat_time"),
    "supply": ("supply_share",),
    "temperature": ("temperature_loss",),
}
# constants with which a term has no effect: compiled code has either no term or all of them
DISABLED = {
    "profile_speed": 1e9, "profile_acceleration": 1e12, "dead_zone": 0.0, "integral_rate": 0.0, "integral_limit": 0.0,
    "stall_torque": 1e9, "no_load_speed": 1e9, "current_time": 1e-12, "asymmetry": 0.0, "bristle_stiffness": 1e9,
    "output_damping": 0.0,
}  # fmt: skip
# constants of a profile without a limit on speed or acceleration, small enough for float32
UNLIMITED = {"profile_speed": 1e3, "profile_acceleration": 1e5}
# initial constants of the search
INITIAL = {
    "profile_speed": 6.0, "profile_acceleration": 100.0, "dead_zone": 0.003, "integral_rate": 2.0,
    "integral_limit": 0.3, "stall_torque": 3.0, "no_load_speed": 10.0, "current_time": 0.003, "asymmetry": 0.0,
    "bristle_stiffness": 10.0, "output_damping": 0.005, "heat_loss": 0.1, "heat_time": 10.0, "supply_share": 0.7,
    "temperature_loss": 0.0,
}  # fmt: skip
# initial constants of a second search, with which a term has almost no effect
NEGLIGIBLE = {
    "profile_speed": 40.0, "profile_acceleration": 4000.0, "dead_zone": 1e-4, "integral_rate": 0.05,
    "integral_limit": 0.05, "stall_torque": 20.0, "no_load_speed": 100.0, "current_time": 3e-4, "asymmetry": 0.0,
    "bristle_stiffness": 200.0, "output_damping": 1e-4, "heat_loss": 0.01, "heat_time": 10.0, "supply_share": 0.1,
    "temperature_loss": 0.0,
}  # fmt: skip
# constants that may be negative, and their value per unit of decoder output; all others are exp(output)
SIGNED = {"encoder_zero": 0.05, "asymmetry": 0.2, "temperature_loss": 0.1}
# constants that scale with torques of the law, with the field of the magnets, with the voltage
_OF_LAW = ("kp", "torque_limit", "integral_limit")
_OF_MAGNETS = (*_OF_LAW, "stall_torque")
_OF_VOLTAGE = ("stall_torque", "no_load_speed")
MAX_SHARE = 0.9  # maximum asymmetry, and maximum torque loss by heat, supply or temperature [-]
TEMPERATURE_SCALE = 50.0  # temperature rise at which the loss is temperature_loss [K]


class Conditions(NamedTuple):
    """Operating conditions, per motor or the same for all."""

    warmth: Any = 0.0  # of the term heat, from 0 (cold) to 1
    supply: Any = 1.0  # supply voltage / nominal voltage [-]
    temperature_rise: Any = 0.0  # temperature above the nominal one [K]


# at nominal voltage and temperature, at the start of operation and at an unknown time
COLD, HALF_WARM = Conditions(), Conditions(warmth=0.5)


def at_conditions(conditions: Conditions, values: dict[str, Any], xp: Any) -> dict[str, Any]:
    """Constants by name at these conditions; the array module ``xp`` is numpy or jax.numpy."""
    if "heat_loss" in values:
        values = _scaled(1.0 - values["heat_loss"] * conditions.warmth, values, _OF_MAGNETS)
    if "supply_share" in values:
        share = 1.0 + values["supply_share"] * (conditions.supply - 1.0)
        values = _scaled(xp.maximum(share, 1.0 - MAX_SHARE), values, _OF_LAW)
        values = _scaled(conditions.supply, values, _OF_VOLTAGE)
    if "temperature_loss" in values:
        share = 1.0 - values["temperature_loss"] * conditions.temperature_rise / TEMPERATURE_SCALE
        values = _scaled(xp.maximum(share, 1.0 - MAX_SHARE), values, _OF_MAGNETS)
    return values


def _scaled(factor: Any, values: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return values | {name: factor * values[name] for name in names if name in values}


def constants_of(terms: Iterable[str]) -> tuple[str, ...]:
    """Names of the constants of these terms."""
    return tuple(name for term in terms for name in TERMS[term])


def terms_with(constants: Iterable[str]) -> tuple[str, ...]:
    """The terms with any of these constants, in the order of TERMS."""
    wanted = set(constants)
    return tuple(name for name, own in TERMS.items() if wanted & set(own))


def in_order(terms: Iterable[str]) -> tuple[str, ...]:
    """The terms in the order of TERMS."""
    wanted = set(terms)
    return tuple(name for name in TERMS if name in wanted)


def smaller(a: Any, b: Any, arithmetic: Any) -> Any:
    """min(a, b), lane by lane."""
    return a - arithmetic.positive_part(a - b)


def profiled(p: Any, state: Any, target: Any, h: Any, arithmetic: Any) -> Any:
    """The state with the reference moved towards the target for one step."""
    away = target - state.reference
    distance = abs(away)
    change = 0.5 * h * p.profile_acceleration  # change of speed in half a step: whole steps then end at the target
    stopping = arithmetic.sqrt(change * change + 2.0 * p.profile_acceleration * distance) - change
    speed = smaller(smaller(p.profile_speed, stopping, arithmetic), distance / h, arithmetic)
    wanted = arithmetic.with_sign_of(speed, away) - state.reference_vel
    velocity = state.reference_vel + arithmetic.clip(wanted, 2.0 * change)
    return state._replace(reference=state.reference + h * velocity, reference_vel=velocity)


def within_voltage(p: Any, law: Any, v: Any, arithmetic: Any) -> Any:
    """The law's torque within the voltage limit at rotor velocity v."""
    share = v / p.no_load_speed
    upper = arithmetic.positive_part(p.stall_torque * (1.0 - share))
    lower = arithmetic.positive_part(p.stall_torque * (1.0 + share))
    law = smaller(law, upper, arithmetic)
    return law + arithmetic.positive_part(-law - lower)
