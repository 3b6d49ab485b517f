"""A fleet: the population that true motors are drawn from, as a TOML file with units and sources."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.kind import ActuatorKind
from motorprior.actuator.true_motors import TrueMotors
from motorprior.bench.families import FAMILIES, GEARED, Family
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError
from motorprior.outside_files import read_toml
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import TABLE, TEXT, Field, Schema, exactly, number, one_of, require

_TEXT_KEYS = ("name", "motor", "robot")
_LARGEST = 1e9
_LARGEST_LOG_SPREAD = 3.0
"""A lognormal parameter varies by a factor of exp(3) = 20."""
_KEYS = {
    "constant": ("center",),
    "uniform": ("low", "high", "shared"),
    "normal": ("center", "spread", "center_uncertainty", "minimum"),
    "lognormal": ("center", "spread", "center_uncertainty"),
}
_COMPARE = "compare with a shipped fleet"


@dataclass(frozen=True)
class Distribution:
    """One parameter over the fleet.

    constant: center. uniform: [low, high]. normal: center + s·ε, not below ``minimum``.
    lognormal: center·exp(s·ε). s² = spread² (between motors) + center_uncertainty² (of the fit).

    The motors of one robot have ε's part of center_uncertainty in common. Of a uniform range they have ``shared`` in
    common, 0 if it is not given: low + (high - low)·Φ(√shared·ε of the robot + √(1 - shared)·ε of the motor), which is
    uniform again.
    """

    kind: str
    values: dict[str, float]

    @property
    def center(self) -> float:
        """The value of the fleet's central motor."""
        if self.kind == "uniform":
            return 0.5 * (self.values["low"] + self.values["high"])
        return self.values["center"]

    def sample(self, rng: np.random.Generator, count: int, of_one_robot: bool = False) -> np.ndarray:
        """(count,) draws, see `Fleet.sample`."""
        if self.kind == "constant":
            return np.full(count, self.center)
        if self.kind == "uniform":
            return self._uniform(rng, count, of_one_robot)
        spread, uncertainty = self.values["spread"], self.values["center_uncertainty"]
        if of_one_robot:
            noise = spread * rng.standard_normal(count) + uncertainty * rng.standard_normal()
        else:
            noise = np.hypot(spread, uncertainty) * rng.standard_normal(count)
        if self.kind == "lognormal":
            return self.center * np.exp(noise)
        return np.maximum(self.center + noise, self.values.get("minimum", -np.inf))

    def _uniform(self, rng: np.random.Generator, count: int, of_one_robot: bool) -> np.ndarray:
        low, high, shared = self.values["low"], self.values["high"], self.values.get("shared", 0.0)
        if not (of_one_robot and shared):
            return rng.uniform(low, high, count)
        from scipy.special import ndtr  # here: it takes a third of a second, which few fleets need

        robot, motors = rng.standard_normal(), rng.standard_normal(count)
        return low + (high - low) * ndtr(np.sqrt(shared) * robot + np.sqrt(1.0 - shared) * motors)


@dataclass(frozen=True)
class Fleet:
    """A population of true motors."""

    name: str
    motor: str
    robot: str
    parameters: dict[str, Distribution]
    family: str = GEARED.name

    @property
    def kind(self) -> ActuatorKind:
        """Of every motor drawn from it."""
        return FAMILIES[self.family].kind

    def sample(self, count: int, seed: int | np.random.Generator, of_one_robot: bool = False) -> TrueMotors:
        """Draw the constants of ``count`` motors.

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.
            of_one_robot: what is not known of the fleet's center, and what a robot's motors have in common of a range,
                is the same for all of them; otherwise it is drawn for every motor, and averages out over a robot.

        Raises:
            ConfigError: ``count`` is no positive whole number, ``seed`` no seed, or a motor cannot be simulated.
        """
        require_count("count", count)
        rng, family = generator_of(seed), FAMILIES[self.family]
        values = {name: d.sample(rng, count, of_one_robot) for name, d in self.parameters.items()}
        family.require_stable(values, f"fleet {self.name}, a motor drawn from it")
        return family.motors(values)

    def center(self, count: int) -> TrueMotors:
        """``count`` copies of the central motor."""
        values = {name: np.full(count, d.center) for name, d in self.parameters.items()}
        return FAMILIES[self.family].motors(values)

    def summary(self) -> dict[str, dict[str, float | str]]:
        """Kind and values of every parameter, for provenance."""
        return {name: {"kind": d.kind, **d.values} for name, d in self.parameters.items()}


def load_fleet(name_or_path: str | Path) -> Fleet:
    """Load a fleet that comes with a shipped robot, by name, or any fleet TOML by path.

    Args:
        name_or_path: name of a shipped fleet, one of `Robot.fleets`, or the path of a .toml file.

    Returns:
        A distribution per constant of a motor, in SI units.

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value out of range.
        ConfigError: its central motor cannot be simulated, see `Family.require_stable`.
    """
    path = fleet_path(name_or_path)
    data = read_toml(path, _COMPARE)
    family = family_named(data.pop("family", GEARED.name), path, _COMPARE)
    tables = dict.fromkeys(family.units, TABLE)
    Schema(dict.fromkeys(_TEXT_KEYS, TEXT) | tables, _COMPARE, family.optional).check(data, path)
    said = {name: {"unit": exactly(unit), "source": TEXT} for name, unit in family.units.items()}
    parameters = {
        name: _distribution(data[name], "distribution", said[name], name, family, f"{path}[{name}]", _COMPARE)
        for name in family.units
        if name in data
    }
    family.require_stable({name: np.array([d.center]) for name, d in parameters.items()}, f"{path}, its central motor")
    return Fleet(**{key: data[key] for key in _TEXT_KEYS}, parameters=parameters, family=family.name)


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


def family_named(name: Any, where: str | Path | None, remedy: str) -> Family:
    """The family of that name.

    Raises:
        ArtifactError: there is none.
    """
    require("family", name, one_of(*FAMILIES), where, remedy)
    return FAMILIES[name]


def fleet_of(
    name: str, motor: str, robot: str, parameters: Mapping[str, Mapping[str, Any]], where: str, family: Family = GEARED
) -> Fleet:
    """The fleet that `Fleet.summary` describes.

    Raises:
        ArtifactError: unknown or missing parameters or keys, or a value out of range.
    """
    remedy = "record the bench again"
    Schema(dict.fromkeys(family.units, TABLE), remedy, family.optional, "parameters").check(parameters, where)
    made = {
        parameter: _distribution(parameters[parameter], "kind", {}, parameter, family, f"{where}[{parameter}]", remedy)
        for parameter in family.units
        if parameter in parameters
    }
    return Fleet(name, motor, robot, made, family.name)


def _number_fields(kind: str, name: str, family: Family) -> dict[str, Field]:
    """Bounds of the numbers of parameter ``name`` for a distribution of this kind."""
    most, unit, positive = family.largest.get(name, _LARGEST), family.units[name], name in family.positive
    least = -most if name in family.signed else 0.0
    center = number(least, most, above=0.0 if positive else -inf, unit=unit)
    share = kind == "lognormal"  # relative to the center, like the spread of a logarithm
    spread = number(0.0, _LARGEST_LOG_SPREAD, unit="of the center") if share else number(0.0, most, unit=unit)
    shape = {"spread": spread, "center_uncertainty": spread, "minimum": number(least, most, unit=unit)}
    shape["shared"] = number(0.0, 1.0)
    return {key: shape.get(key, center) for key in _KEYS[kind]}


def _distribution(
    table: Mapping[str, Any],
    kind_key: str,
    others: Mapping[str, Field],
    name: str,
    family: Family,
    where: str,
    remedy: str,
) -> Distribution:
    """The distribution of parameter ``name``, after checks of keys and ranges in its table."""
    kind = table.get(kind_key)
    require(kind_key, kind, one_of(*_KEYS), where, remedy)
    numbers = _number_fields(str(kind), name, family)
    schema = Schema({kind_key: TEXT, **others, **numbers}, remedy, optional=frozenset({"minimum", "shared"}))
    schema.check(table, where)
    values = {key: float(table[key]) for key in numbers if key in table}
    if kind == "normal" and name in family.positive and not values.get("minimum", 0.0) > 0:
        raise ArtifactError(
            "a normal distribution can draw values that are not above 0",
            where=where,
            remedy="give a minimum above 0, or use lognormal",
        )
    if kind == "uniform" and values["low"] > values["high"]:
        raise ArtifactError(f"low {values['low']} exceeds high {values['high']}", where=where, remedy="swap them")
    return Distribution(str(kind), values)
