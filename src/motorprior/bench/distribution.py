"""Distributions of constants over a fleet, as tables in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bench.families import Family
from motorprior.exceptions import ArtifactError
from motorprior.schema import TABLE, TEXT, Field, Schema, exactly, number, one_of, require

_MAX_LOG_SPREAD = 3.0  # a factor of exp(3) = 20
_KEYS = {
    "constant": ("center",),
    "uniform": ("low", "high", "shared"),
    "normal": ("center", "spread", "center_uncertainty", "minimum"),
    "lognormal": ("center", "spread", "center_uncertainty"),
}


@dataclass(frozen=True)
class Distribution:
    """One parameter over the fleet.

    constant: center. uniform: [low, high]. normal: center + s·ε, at least ``minimum``. lognormal: center·exp(s·ε).
    s² = spread² (between motors) + center_uncertainty² (of the fit). A fleet clips samples to `bounds_of`.

    Motors of one robot share the sample of center_uncertainty, and of a uniform range the fraction ``shared`` (default
    0) of the variance: low + (high - low)·Φ(√shared·ε of the robot + √(1 - shared)·ε of the motor).
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
        """(count,) samples, see `Fleet.sample`."""
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
        from scipy.special import ndtr  # imported here: it takes 0.3 s, and few fleets need it

        robot, motors = rng.standard_normal(), rng.standard_normal(count)
        return low + (high - low) * ndtr(np.sqrt(shared) * robot + np.sqrt(1.0 - shared) * motors)


def distributions_of(
    tables: Mapping[str, Any], family: Family, where: str | Path, remedy: str, with_sources: bool = False
) -> dict[str, Distribution]:
    """Distributions of the parameters of a family, by name, after checks of keys and ranges.

    Args:
        tables: a table per parameter, as in `Fleet.summary`.
        family: the motors.
        where: file, for errors.
        remedy: for errors.
        with_sources: tables are those of a fleet file, with a unit and a source.

    Raises:
        ArtifactError: unknown or missing keys, wrong unit, or a value out of range.
    """
    Schema(dict.fromkeys(family.units, TABLE), remedy, family.optional, "parameters").check(tables, where)
    kind_key = "distribution" if with_sources else "kind"
    found = {}
    for name, unit in family.units.items():
        if name in tables:
            fields = {kind_key: TEXT} | ({"unit": exactly(unit), "source": TEXT} if with_sources else {})
            found[name] = _distribution_of(tables[name], kind_key, fields, name, family, f"{where}[{name}]", remedy)
    return found


def _distribution_of(
    table: Mapping[str, Any],
    kind_key: str,
    fields: dict[str, Field],
    name: str,
    family: Family,
    where: str,
    remedy: str,
) -> Distribution:
    kind = table.get(kind_key)
    require(kind_key, kind, one_of(*_KEYS), where, remedy)
    numbers = _number_fields(str(kind), name, family)
    Schema(fields | numbers, remedy, optional=frozenset({"minimum", "shared"})).check(table, where)
    values = {key: float(table[key]) for key in numbers if key in table}
    if kind == "normal" and name in family.positive and not values.get("minimum", 0.0) > 0:
        problem = "a normal distribution can give values that are not above 0"
        raise ArtifactError(problem, where=where, remedy="give a minimum above 0, or use lognormal")
    if kind == "uniform" and values["low"] > values["high"]:
        raise ArtifactError(f"low {values['low']} exceeds high {values['high']}", where=where, remedy="swap them")
    return Distribution(str(kind), values)


def _number_fields(kind: str, name: str, family: Family) -> dict[str, Field]:
    (low, high), unit, positive = bounds_of(name, family), family.units[name], name in family.positive
    unit = "" if unit == "1" else unit
    center = number(low, high, above=0.0 if positive else -inf, unit=unit)
    relative = kind == "lognormal"  # the spread is that of the logarithm
    spread = number(0.0, _MAX_LOG_SPREAD, unit="of the center") if relative else number(0.0, high, unit=unit)
    shape = {"spread": spread, "center_uncertainty": spread, "minimum": number(low, high, unit=unit)}
    shape["shared"] = number(0.0, 1.0)
    return {key: shape.get(key, center) for key in _KEYS[kind]}


def bounds_of(name: str, family: Family) -> tuple[float, float]:
    """Bounds of a parameter in SI units; samples are clipped to them."""
    high = family.max_values.get(name, 1e9)
    return -high if name in family.signed else 0.0, high
