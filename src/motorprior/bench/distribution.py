"""The distribution of one constant over a fleet, as a table in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from motorprior.bench.families import Family
from motorprior.exceptions import ArtifactError
from motorprior.schema import TEXT, Field, Schema, number, one_of, require

_LARGEST = 1e9
_LARGEST_LOG_SPREAD = 3.0  # A lognormal parameter varies by a factor of exp(3) = 20
_KEYS = {
    "constant": ("center",),
    "uniform": ("low", "high", "shared"),
    "normal": ("center", "spread", "center_uncertainty", "minimum"),
    "lognormal": ("center", "spread", "center_uncertainty"),
}


@dataclass(frozen=True)
class Distribution:
    """One parameter over the fleet.

    constant: center. uniform: [low, high]. normal: center + s·ε, not below ``minimum``. lognormal: center·exp(s·ε).
    s² = spread² (between motors) + center_uncertainty² (of the fit). A fleet clips samples to `bounds_of`.

    The motors of one robot share the part of center_uncertainty, and of a uniform range the part ``shared``, 0 if not
    given: low + (high - low)·Φ(√shared·ε of the robot + √(1 - shared)·ε of the motor).
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


def _number_fields(kind: str, name: str, family: Family) -> dict[str, Field]:
    (least, most), unit, positive = bounds_of(name, family), family.units[name], name in family.positive
    unit = "" if unit == "1" else unit
    center = number(least, most, above=0.0 if positive else -inf, unit=unit)
    share = kind == "lognormal"  # relative to the center, like the spread of a logarithm
    spread = number(0.0, _LARGEST_LOG_SPREAD, unit="of the center") if share else number(0.0, most, unit=unit)
    shape = {"spread": spread, "center_uncertainty": spread, "minimum": number(least, most, unit=unit)}
    shape["shared"] = number(0.0, 1.0)
    return {key: shape.get(key, center) for key in _KEYS[kind]}


def distribution_of(
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
        problem = "a normal distribution can draw values that are not above 0"
        raise ArtifactError(problem, where=where, remedy="give a minimum above 0, or use lognormal")
    if kind == "uniform" and values["low"] > values["high"]:
        raise ArtifactError(f"low {values['low']} exceeds high {values['high']}", where=where, remedy="swap them")
    return Distribution(str(kind), values)


def bounds_of(name: str, family: Family) -> tuple[float, float]:
    """Least and largest value of a parameter [SI]; draws beyond are put there."""
    most = family.largest.get(name, _LARGEST)
    return -most if name in family.signed else 0.0, most
