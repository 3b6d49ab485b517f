"""A fleet: the population that physical motors are drawn from, as a TOML file with units and sources."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.physical import MotorParameters
from motorprior.artifacts import require_keys
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError
from motorprior.robots.shipped import SHIPPED

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
"""Bounds of a number of one parameter; the memory of a motor grows with its delay."""
_LARGEST_LOG_SPREAD = 3.0
"""A lognormal parameter varies by a factor of exp(3) = 20."""
_KEYS = {
    "constant": ({"center"}, set()),
    "uniform": ({"low", "high"}, set()),
    "normal": ({"center", "spread", "center_uncertainty"}, {"minimum"}),
    "lognormal": ({"center", "spread", "center_uncertainty"}, set()),
}


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
        name_or_path: ``"pupper_v2"``, ``"mixed"``, or a .toml file.

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
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy="compare with a shipped fleet") from error
    require_keys(data, (*_TEXT_KEYS, *UNITS), path)
    texts = {key: str(data[key]) for key in _TEXT_KEYS}
    return Fleet(**texts, parameters={name: _distribution(data[name], name, path) for name in UNITS})


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
    """The fleet that `Fleet.summary` tells of.

    Raises:
        ArtifactError: unknown or missing parameters or keys, or a value out of range.
    """
    for key, text in (("name", name), ("motor", motor), ("robot", robot)):
        if not isinstance(text, str):
            raise ArtifactError(f"{key} {text!r} is not a text", where=where, remedy="record the bench anew")
    if not isinstance(parameters, Mapping):
        raise ArtifactError("its parameters are not a table", where=where, remedy="record the bench anew")
    require_keys(parameters, UNITS, where)
    made = {}
    for parameter in UNITS:
        table, place = parameters[parameter], f"{where}[{parameter}]"
        kind = _known_kind(table, "kind", place)
        made[parameter] = _checked(kind, {key: table[key] for key in table if key != "kind"}, parameter, place)
    return Fleet(name, motor, robot, made)


def _distribution(table: dict, name: str, path: Path) -> Distribution:
    where = f"{path}[{name}]"
    kind = _known_kind(table, "distribution", where)
    required, optional = _KEYS[kind]
    numbers = {key: value for key, value in table.items() if key not in ("unit", "source", "distribution")}
    require_keys(table, {"unit", "source", "distribution", *required, *(optional & numbers.keys())}, where)
    if table["unit"] != UNITS[name]:
        raise ArtifactError(f"unit {table['unit']!r}", where=where, remedy=f"give it in {UNITS[name]!r}")
    return _checked(kind, numbers, name, where)


def _known_kind(table: object, key: str, where: str) -> str:
    kind = table.get(key) if isinstance(table, dict) else None
    if not isinstance(kind, str) or kind not in _KEYS:
        raise ArtifactError(f"distribution {kind!r} is unknown", where=where, remedy=f"use one of {', '.join(_KEYS)}")
    return kind


def _checked(kind: str, numbers: dict[str, Any], name: str, where: str) -> Distribution:
    """The distribution of parameter ``name``, if its numbers are those of its kind and in range."""
    required, optional = _KEYS[kind]
    require_keys(numbers, required | (optional & numbers.keys()), where)
    for key, value in numbers.items():
        _check_number(key, value, name, where)
        if kind == "lognormal" and key != "center" and value > _LARGEST_LOG_SPREAD:
            raise ArtifactError(
                f"{key} = {value} of a logarithm is above {_LARGEST_LOG_SPREAD:g}", where=where,
                remedy="give it as a share of the center, for example 0.1",
            )  # fmt: skip
    if kind == "normal" and name in _STRICTLY_POSITIVE and not numbers.get("minimum", 0.0) > 0:
        raise ArtifactError(
            "a normal distribution can draw values that are not above 0",
            where=where,
            remedy="give a minimum above 0, or use lognormal",
        )
    if kind == "uniform" and numbers["low"] > numbers["high"]:
        raise ArtifactError(f"low {numbers['low']} exceeds high {numbers['high']}", where=where, remedy="swap them")
    return Distribution(kind, {key: float(value) for key, value in numbers.items()})


def _check_number(key: str, value: object, name: str, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ArtifactError(f"{key} = {value!r} is not a finite number", where=where, remedy="give a number")
    if isinstance(value, float) and not isfinite(value):
        raise ArtifactError(f"{key} = {value!r} is not a finite number", where=where, remedy="give a number")
    most = _LARGEST_OF.get(name, _LARGEST)
    if abs(value) > most:
        raise ArtifactError(
            f"{key} = {str(value)[:20]} is above {most:g} {UNITS[name]}", where=where, remedy=f"give {most:g} or less"
        )
    central = key in ("center", "low", "high")
    if name in _STRICTLY_POSITIVE and central and value <= 0:
        raise ArtifactError(f"{key} = {value} must be above 0", where=where, remedy="give a positive value")
    if name != "encoder_zero" and value < 0:
        raise ArtifactError(f"{key} = {value} must not be below 0", where=where, remedy="give 0 or more")
