"""A fleet: the population that physical motors are drawn from, as a TOML file with units and sources."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import TABLE, TEXT, Field, Schema, exactly, number, one_of, require

_TEXT_KEYS = ("name", "motor", "robot")
UNITS = {
    "kp": "N·m/rad",
    "kd_over_kp": "s",
    "delay": "s",
    "velocity_filter": "s",
    "torque_limit": "N·m",
    "stall_torque": "N·m",
    "no_load_speed": "rad/s",
    "armature": "kg·m²",
    "coulomb": "N·m",
    "stribeck_torque": "N·m",
    "stribeck_velocity": "rad/s",
    "viscous_damping": "N·m·s/rad",
    "load_friction": "1",
    "backlash": "rad",
    "gear_stiffness": "N·m/rad",
    "gear_damping": "N·m·s/rad",
    "encoder_zero": "rad",
}
_STRICTLY_POSITIVE = {
    "kp", "kd_over_kp", "velocity_filter", "torque_limit", "stall_torque", "no_load_speed", "armature",
    "stribeck_velocity", "gear_stiffness",
}  # fmt: skip
_LARGEST = 1e9
_LARGEST_OF = {"delay": 1.0, "velocity_filter": 1.0}
"""Upper bounds of the delay and of the velocity filter's time constant [s]; a delay takes memory."""
_LARGEST_LOG_SPREAD = 3.0
"""A lognormal parameter varies by a factor of exp(3) = 20."""
_KEYS = {
    "constant": ("center",),
    "uniform": ("low", "high"),
    "normal": ("center", "spread", "center_uncertainty", "minimum"),
    "lognormal": ("center", "spread", "center_uncertainty"),
}
_COMPARE = "compare with a shipped fleet"


@dataclass(frozen=True)
class Distribution:
    """One parameter over the fleet.

    constant: center. uniform: [low, high]. normal: center + s·ε, not below ``minimum``.
    lognormal: center·exp(s·ε). s² = spread² (between motors) + center_uncertainty² (of the fit).
    """

    kind: str
    values: dict[str, float]

    @property
    def center(self) -> float:
        """The value of the fleet's central motor."""
        if self.kind == "uniform":
            return 0.5 * (self.values["low"] + self.values["high"])
        return self.values["center"]

    def sample(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count,) draws."""
        if self.kind == "constant":
            return np.full(count, self.center)
        if self.kind == "uniform":
            return rng.uniform(self.values["low"], self.values["high"], count)
        noise = np.hypot(self.values["spread"], self.values["center_uncertainty"]) * rng.standard_normal(count)
        if self.kind == "lognormal":
            return self.center * np.exp(noise)
        return np.maximum(self.center + noise, self.values.get("minimum", -np.inf))


@dataclass(frozen=True)
class Fleet:
    """A population of physical motors."""

    name: str
    motor: str
    robot: str
    parameters: dict[str, Distribution]

    def sample(self, count: int, seed: int | np.random.Generator) -> MotorParameters:
        """Draw the constants of ``count`` motors.

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.

        Raises:
            ConfigError: ``count`` is no positive whole number, or ``seed`` no seed.
        """
        require_count("count", count)
        rng = generator_of(seed)
        return _assemble({name: self.parameters[name].sample(rng, count) for name in UNITS})

    def center(self, count: int) -> MotorParameters:
        """``count`` copies of the central motor."""
        return _assemble({name: np.full(count, self.parameters[name].center) for name in UNITS})

    def summary(self) -> dict[str, dict[str, float | str]]:
        """Kind and values of every parameter, for provenance."""
        return {name: {"kind": d.kind, **d.values} for name, d in self.parameters.items()}


def _assemble(values: dict[str, np.ndarray]) -> MotorParameters:
    values = {**values, "kd": values["kp"] * values["kd_over_kp"]}
    return MotorParameters(**{field.name: values[field.name] for field in fields(MotorParameters)})


def load_fleet(name_or_path: str | Path) -> Fleet:
    """Load a fleet that comes with a shipped robot, by name, or any fleet TOML by path.

    Args:
        name_or_path: name of a shipped fleet, one of `Robot.fleets`, or the path of a .toml file.

    Returns:
        A distribution per constant of a motor, in SI units.

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value out of range.
    """
    path = fleet_path(name_or_path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error
    except (ValueError, RecursionError) as error:  # also a number of more digits than Python reads
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy=_COMPARE) from error
    Schema(dict.fromkeys(_TEXT_KEYS, TEXT) | dict.fromkeys(UNITS, TABLE), _COMPARE).check(data, path)
    texts = {key: data[key] for key in _TEXT_KEYS}
    said = {name: {"unit": exactly(unit), "source": TEXT} for name, unit in UNITS.items()}
    return Fleet(
        **texts,
        parameters={
            name: _distribution(data[name], "distribution", said[name], name, f"{path}[{name}]", _COMPARE)
            for name in UNITS
        },
    )


def fleet_path(name_or_path: str | Path) -> Path:
    """The file of a fleet.

    Raises:
        ArtifactError: there is none.
    """
    path, shipped = Path(name_or_path), {name: file for robot in SHIPPED for name, file in robot.fleets}
    if path.suffix != ".toml":
        path = Path(shipped.get(str(name_or_path), name_or_path))
    if path.suffix != ".toml" or not path.is_file():
        known = ", ".join(sorted(shipped))
        raise ArtifactError(f"no fleet {name_or_path!r}", remedy=f"use one of {known}, or a path to a .toml file")
    return path


def fleet_of(name: str, motor: str, robot: str, parameters: Mapping[str, Mapping[str, Any]], where: str) -> Fleet:
    """The fleet that `Fleet.summary` describes.

    Raises:
        ArtifactError: unknown or missing parameters or keys, or a value out of range.
    """
    remedy = "record the bench again"
    Schema(dict.fromkeys(UNITS, TABLE), remedy, name="parameters").check(parameters, where)
    made = {
        parameter: _distribution(parameters[parameter], "kind", {}, parameter, f"{where}[{parameter}]", remedy)
        for parameter in UNITS
    }
    return Fleet(name, motor, robot, made)


def _number_fields(kind: str, name: str) -> dict[str, Field]:
    """Bounds of the numbers of parameter ``name`` for a distribution of this kind."""
    most, unit, positive = _LARGEST_OF.get(name, _LARGEST), UNITS[name], name in _STRICTLY_POSITIVE
    least = -most if name == "encoder_zero" else 0.0
    center = number(least, most, above=0.0 if positive else -inf, unit=unit)
    share = kind == "lognormal"  # relative to the center, like the spread of a logarithm
    spread = number(0.0, _LARGEST_LOG_SPREAD, unit="of the center") if share else number(0.0, most, unit=unit)
    shape = {"spread": spread, "center_uncertainty": spread, "minimum": number(least, most, unit=unit)}
    return {key: shape.get(key, center) for key in _KEYS[kind]}


def _distribution(
    table: Mapping[str, Any], kind_key: str, others: Mapping[str, Field], name: str, where: str, remedy: str
) -> Distribution:
    """The distribution of parameter ``name``, after checks of keys and ranges in its table."""
    kind = table.get(kind_key)
    require(kind_key, kind, one_of(*_KEYS), where, remedy)
    numbers = _number_fields(str(kind), name)
    schema = Schema({kind_key: TEXT, **others, **numbers}, remedy, optional=frozenset({"minimum"}))
    schema.check(table, where)
    values = {key: float(table[key]) for key in numbers if key in table}
    if kind == "normal" and name in _STRICTLY_POSITIVE and not values.get("minimum", 0.0) > 0:
        raise ArtifactError(
            "a normal distribution can draw values that are not above 0",
            where=where,
            remedy="give a minimum above 0, or use lognormal",
        )
    if kind == "uniform" and values["low"] > values["high"]:
        raise ArtifactError(f"low {values['low']} exceeds high {values['high']}", where=where, remedy="swap them")
    return Distribution(str(kind), values)
