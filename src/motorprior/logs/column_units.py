"""Units of the columns of a table.

The table of a channel overrides that of its joint, and that overrides [units].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorprior.bounds import TABLE, Field, is_number, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema

REMEDY = "see docs/your-motors.md"
TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SCALES: dict[str, dict[str, float]] = {
    "angle": {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan},  # tick: TURN / ticks_per_turn
    "velocity": {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0},
    "torque": {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665},
    "voltage": {"V": 1.0, "dV": 0.1, "mV": 1e-3},
    "temperature": {"degC": 1.0},
}
QUANTITIES = {  # of the channels that may have a sign or a unit of their own
    "position_target": "angle", "joint_pos": "angle", "joint_vel": "velocity", "joint_torque": "torque",
    "external_torque": "torque", "supply_voltage": "voltage", "motor_temperature": "temperature",
}  # fmt: skip
UNITS = {name: one_of(*scales) for name, scales in SCALES.items()} | {"ticks_per_turn": number(above=1.0)}
_SIGNED = {
    "sign": Field("1 or -1", lambda value: is_number(value, -1.0, 1.0) and abs(value) == 1),
    "scale": number(above=0.0),
}
_OF_ANGLES = {
    **_SIGNED,
    "zero": number(-TURN, TURN, unit="rad"),
    "angle": UNITS["angle"],
    "ticks_per_turn": UNITS["ticks_per_turn"],
}
_ENTRIES = {  # of the table of a channel, by its quantity
    "angle": _OF_ANGLES,
    "velocity": {**_SIGNED, "velocity": UNITS["velocity"]},
    "torque": {**_SIGNED, "torque": UNITS["torque"]},
    "voltage": {"scale": _SIGNED["scale"], "voltage": UNITS["voltage"]},
    "temperature": {"scale": _SIGNED["scale"]},
}


def optional(fields: Mapping[str, Field], name: str = "") -> Schema:
    """A table of optional entries."""
    return Schema(fields, REMEDY, optional=frozenset(fields), name=name)


OF_JOINTS = {**_OF_ANGLES, **dict.fromkeys(QUANTITIES, TABLE)}  # of its command and angle, and tables of channels


@dataclass(frozen=True)
class Conversion:
    """A value in SI units is factor·value of the column + offset."""

    factor: float = 1.0
    offset: float = 0.0


def conversions(joint: Mapping[str, Any], units: Mapping[str, Any], where: str) -> dict[str, Conversion]:
    """The conversion of each channel of QUANTITIES for one joint.

    Args:
        joint: its table, with tables of its channels.
        units: the table [units].
        where: names the joint's table.

    Raises:
        ArtifactError: an unknown entry, or ticks without ticks_per_turn.
    """
    found, sign = {}, joint.get("sign", 1)
    for name, quantity in QUANTITIES.items():
        own, of_joint = joint.get(name, {}), joint if quantity == "angle" else {}
        optional(_ENTRIES[quantity]).check(own, f"{where}.{name}")
        factor, zero = _scale(quantity, (own, of_joint, units), where), own.get("zero", of_joint.get("zero", 0.0))
        if "sign" in _ENTRIES[quantity]:
            default = joint.get("joint_pos", {}).get("sign", sign) if name == "joint_vel" else sign
            factor *= own.get("sign", default)
        found[name] = Conversion(float(factor), float(zero))
    return found


def _scale(quantity: str, tables: tuple[Mapping[str, Any], ...], where: str) -> float:
    """SI units per unit of the column, from the first table that gives one."""
    ticks: Any = next((table["ticks_per_turn"] for table in tables if "ticks_per_turn" in table), None)
    for table in tables:
        default = "tick" if quantity == "angle" and "ticks_per_turn" in table else None
        unit = table.get("scale", table.get(quantity, default))
        if unit == "tick" and ticks is None:
            raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=REMEDY)
        if unit == "tick":
            return TURN / ticks
        if unit is not None:
            return SCALES[quantity][unit] if isinstance(unit, str) else float(unit)
    return 1.0
