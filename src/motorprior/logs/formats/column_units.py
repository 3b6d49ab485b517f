"""Units of the columns of a table.

The table of a channel overrides that of its joint, and that overrides [units].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motorprior.bounds import Field, is_number, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema

REMEDY = "see docs/your-motors.md"
TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
VOLTAGES = {"V": 1.0, "dV": 0.1, "mV": 1e-3}
SCALES: dict[str, dict[str, float]] = {
    "angle": {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan},  # tick: TURN / ticks_per_turn
    "velocity": {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0},
    "torque": {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665},
    "voltage": VOLTAGES,
    "temperature": {"degC": 1.0},
}
QUANTITIES = {  # of the channels that may have a sign or a unit of their own
    "position_target": "angle", "joint_pos": "angle", "joint_vel": "velocity", "joint_torque": "torque",
    "external_torque": "torque", "supply_voltage": "voltage", "motor_temperature": "temperature",
}  # fmt: skip
UNITS = {name: one_of(*SCALES[name]) for name in ("angle", "velocity", "torque", "voltage")}
UNITS["ticks_per_turn"] = number(above=1.0)
_SIGN = {"sign": Field("1 or -1", lambda value: is_number(value, -1.0, 1.0) and abs(value) == 1)}
_SCALE = {"scale": number(above=0.0)}
OF_ANGLES = {  # entries of a joint that hold for its command and its angle, and of the tables of these channels
    **_SIGN,
    **_SCALE,
    "zero": number(-TURN, TURN, unit="rad"),
    "angle": UNITS["angle"],
    "ticks_per_turn": UNITS["ticks_per_turn"],
}
_ENTRIES = {
    "angle": OF_ANGLES,
    "velocity": {**_SIGN, **_SCALE, "velocity": UNITS["velocity"]},
    "torque": {**_SIGN, **_SCALE, "torque": UNITS["torque"]},
    "voltage": {**_SCALE, "voltage": UNITS["voltage"]},
    "temperature": _SCALE,
}


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
        ArtifactError: an unknown entry, two units for one column, or ticks without ticks_per_turn.
    """
    _require_one_unit(joint, "angle", where)
    sign = joint.get("sign", 1)
    found = {}
    for name, quantity in QUANTITIES.items():
        own = joint.get(name, {})
        entries = _ENTRIES[quantity]
        Schema(entries, REMEDY, optional=frozenset(entries)).check(own, f"{where}.{name}")
        _require_one_unit(own, quantity, f"{where}.{name}")
        factor = _scale(quantity, (own, joint if quantity == "angle" else {}, units), where)
        zero = own.get("zero", joint.get("zero", 0.0)) if quantity == "angle" else 0.0
        if "sign" in entries:
            default = joint.get("joint_pos", {}).get("sign", sign) if name == "joint_vel" else sign
            factor *= own.get("sign", default)
        found[name] = Conversion(float(factor), float(zero))
    return found


def _require_one_unit(table: Mapping[str, Any], quantity: str, where: str) -> None:
    if double := [name for name in (quantity, "ticks_per_turn") if "scale" in table and name in table]:
        problem = f"scale = {table['scale']:g} and {double[0]} = {table[double[0]]!r}"
        raise ArtifactError(problem, where=where, remedy="give one of the two")


def _scale(quantity: str, tables: tuple[Mapping[str, Any], ...], where: str) -> float:
    """SI units per unit of the column, from the first table that gives one."""
    given = (table.get("scale", table.get(quantity)) for table in tables)
    unit = next((unit for unit in given if unit is not None), None)
    if unit is None:
        return 1.0
    if unit == "tick":
        ticks = next((table["ticks_per_turn"] for table in tables if "ticks_per_turn" in table), None)
        if ticks is None:
            raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=REMEDY)
        return TURN / ticks
    return SCALES[quantity][unit] if isinstance(unit, str) else float(unit)
