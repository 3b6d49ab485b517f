"""Units of the columns of a table: how a number of a column becomes one in SI units, for every channel of a joint.

What a column map says of a channel of a joint counts before what it says of the joint, and that before its [units].
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motorprior.bounds import is_number
from motorprior.exceptions import ArtifactError
from motorprior.schema import Field, Schema, number, one_of

REMEDY = "see docs/your-motors.md"
TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan}
VELOCITIES = {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0}
VOLTAGES = {"V": 1.0, "dV": 0.1, "mV": 1e-3}
TEMPERATURES = {"degC": 1.0}
TORQUES = {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665}
QUANTITIES = {
    "position_target": "angle", "joint_pos": "angle", "joint_vel": "velocity", "joint_torque": "torque",
    "external_torque": "torque", "supply_voltage": "voltage", "motor_temperature": "temperature",
}  # fmt: skip
"""Channels whose columns may have a sign, where they can point, and a unit of their own."""
_NAMED: dict[str, dict[str, float]] = {
    "angle": ANGLES, "velocity": VELOCITIES, "torque": TORQUES, "voltage": VOLTAGES, "temperature": TEMPERATURES,
}  # fmt: skip
_WITHOUT_SIGN = ("voltage", "temperature")
UNITS = {
    "angle": one_of(*ANGLES),
    "velocity": one_of(*VELOCITIES),
    "torque": one_of(*TORQUES),
    "voltage": one_of(*VOLTAGES),
    "ticks_per_turn": number(above=1.0),
}
"""Entries of [units] that are said here."""
_SIGN = {"sign": Field("1 or -1", lambda value: is_number(value, -1.0, 1.0) and abs(value) == 1)}
_SCALE = {"scale": number(above=0.0)}
OF_ANGLES = {
    **_SIGN,
    **_SCALE,
    "zero": number(-TURN, TURN, unit="rad"),
    "angle": UNITS["angle"],
    "ticks_per_turn": UNITS["ticks_per_turn"],
}
"""Entries of a joint that are of its command and its angle, and of the table of one of these channels."""
_OF = {
    "angle": OF_ANGLES,
    "velocity": {**_SIGN, **_SCALE, "velocity": UNITS["velocity"]},
    "torque": {**_SIGN, **_SCALE, "torque": UNITS["torque"]},
    "voltage": {**_SCALE, "voltage": UNITS["voltage"]},
    "temperature": _SCALE,
}
_CHANNELS = {
    channel: Schema(_OF[quantity], REMEDY, optional=frozenset(_OF[quantity]))
    for channel, quantity in QUANTITIES.items()
}
Tables = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Conversion:
    """A value in SI units is factor·value of the column + offset."""

    factor: float = 1.0
    offset: float = 0.0


def conversions(joint: Mapping[str, Any], units: Mapping[str, Any], where: str) -> dict[str, Conversion]:
    """Of each of QUANTITIES, of one joint; other channels are in SI units.

    Args:
        joint: its table, with tables of its channels.
        units: the table [units].
        where: names the joint's table.

    Raises:
        ArtifactError: an entry that is not understood, two units for one column, or ticks of unknown size.
    """
    _check(joint, where)
    signs = {
        name: 1 if quantity in _WITHOUT_SIGN else joint.get(name, {}).get("sign", joint.get("sign", 1))
        for name, quantity in QUANTITIES.items()
    }
    signs["joint_vel"] = joint.get("joint_vel", {}).get("sign", signs["joint_pos"])
    found = {}
    for name, quantity in QUANTITIES.items():
        tables = _tables(name, joint, units)
        zero = next((table["zero"] for table in tables[:2] if "zero" in table), 0.0) if quantity == "angle" else 0.0
        found[name] = Conversion(float(signs[name]) * _scale(quantity, tables, where), float(zero))
    return found


def require_ticks(joints: Mapping[str, Mapping[str, Any]], units: Mapping[str, Any], where: str) -> None:
    """Refuse a size of ticks where no angle is in ticks of this size.

    Args:
        joints: the tables [joints.…] by their names.
        units: the table [units].
        where: names the map.

    Raises:
        ArtifactError: names the table and the value.
    """
    used = [owner for joint in joints.values() for owner in _owners_of_ticks(joint, units)]
    for name, table in _with_ticks(joints, units):
        if not any(table is owner for owner in used):
            raise ArtifactError(
                f"{name}: ticks_per_turn = {table['ticks_per_turn']:g}, and no angle is in ticks", where=where,
                remedy='state angle = "tick" beside it, or leave it out',
            )  # fmt: skip


def _check(joint: Mapping[str, Any], where: str) -> None:
    _require_one_unit(joint, "angle", where)
    for name in QUANTITIES.keys() & joint.keys():
        _CHANNELS[name].check(joint[name], f"{where}.{name}")
        _require_one_unit(joint[name], QUANTITIES[name], f"{where}.{name}")


def _require_one_unit(table: Mapping[str, Any], quantity: str, where: str) -> None:
    if twice := [name for name in (quantity, "ticks_per_turn") if "scale" in table and name in table]:
        problem = f"scale = {table['scale']:g} and {twice[0]} = {table[twice[0]]!r}"
        raise ArtifactError(problem, where=where, remedy="give one of the two")


def _tables(channel: str, joint: Mapping[str, Any], units: Mapping[str, Any]) -> Tables:
    """What may say the unit of a joint's channel, the first that does so first."""
    of_joint = joint if QUANTITIES[channel] == "angle" else {}
    return joint.get(channel, {}), of_joint, units


def _unit(quantity: str, tables: Tables) -> float | str:
    """A scale or the name of a unit."""
    said = (table.get("scale", table.get(quantity)) for table in tables)
    return next((unit for unit in said if unit is not None), next(iter(_NAMED[quantity])))


def _scale(quantity: str, tables: Tables, where: str) -> float:
    """SI units per unit of the column."""
    unit = _unit(quantity, tables)
    if unit == "tick":
        if (owner := _owner_of_ticks(tables)) is None:
            raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=REMEDY)
        return TURN / owner["ticks_per_turn"]
    return _NAMED[quantity][unit] if isinstance(unit, str) else float(unit)


def _owner_of_ticks(tables: Tables) -> Mapping[str, Any] | None:
    return next((table for table in tables if "ticks_per_turn" in table), None)


def _owners_of_ticks(joint: Mapping[str, Any], units: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The tables that say how large the ticks of a joint's angles are."""
    for name, quantity in QUANTITIES.items():
        tables = _tables(name, joint, units)
        if _unit(quantity, tables) == "tick" and (owner := _owner_of_ticks(tables)) is not None:
            yield owner


def _with_ticks(
    joints: Mapping[str, Mapping[str, Any]], units: Mapping[str, Any]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every table with a size of ticks, and its name."""
    named = {"units": units}
    for name, joint in joints.items():
        named[f"joints.{name}"] = joint
        named |= {f"joints.{name}.{channel}": joint[channel] for channel in QUANTITIES.keys() & joint.keys()}
    yield from ((name, table) for name, table in named.items() if "ticks_per_turn" in table)
