"""Distribution of one parameter of physical motors over a fleet."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.families import Family
from motorprior.bounds import TABLE, TEXT, Field, exactly, number, one_of, require
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema

_MAX_LOG_SPREAD = 3.0  # a factor of exp(3) = 20
_KEYS_OF_FORM = {
    "constant": ("center",),
    "uniform": ("low", "high", "shared"),
    "normal": ("center", "spread", "center_uncertainty", "minimum"),
    "lognormal": ("center", "spread", "center_uncertainty"),
}
_OPTIONAL_KEYS = frozenset({"minimum", "shared"})


@dataclass(frozen=True)
class Distribution:
    """One parameter over the fleet.

    The form is one of

        constant:   center
        uniform:    [low, high]
        normal:     center + s·ε, at least ``minimum``
        lognormal:  center·exp(s·ε)

    with s² = spread² (between motors) + center_uncertainty² (of the fit). A fleet clips samples to
    `Family.bounds`.

    Motors of one robot share the sample of center_uncertainty. Of a uniform range they share the
    fraction ``shared`` (default 0) of the variance: low + (high - low)·Φ(√shared·ε of the robot +
    √(1 - shared)·ε of the motor).
    """

    form: str
    values: dict[str, float]

    @property
    def center(self) -> float:
        """The value of the fleet's central motor."""
        if self.form == "uniform":
            return 0.5 * (self.values["low"] + self.values["high"])
        return self.values["center"]

    def sample(
        self, rng: np.random.Generator, count: int, of_one_robot: bool = False
    ) -> np.ndarray:
        """(count,) samples; see `Fleet.sample`."""
        if self.form == "constant":
            return np.full(count, self.center)
        if self.form == "uniform":
            return self._uniform_samples(rng, count, of_one_robot)

        deviation = self._deviations(rng, count, of_one_robot)
        if self.form == "lognormal":
            return self.center * np.exp(deviation)
        return np.maximum(self.center + deviation, self.values.get("minimum", -np.inf))

    def _uniform_samples(
        self, rng: np.random.Generator, count: int, of_one_robot: bool
    ) -> np.ndarray:
        low = self.values["low"]
        high = self.values["high"]
        shared = self.values.get("shared", 0.0)
        if not (of_one_robot and shared):
            return rng.uniform(low, high, count)

        from scipy.special import ndtr  # imported here: it takes 0.3 s, and few fleets need it

        of_robot = rng.standard_normal()
        of_motors = rng.standard_normal(count)
        quantile = ndtr(np.sqrt(shared) * of_robot + np.sqrt(1.0 - shared) * of_motors)
        return low + (high - low) * quantile

    def _deviations(self, rng: np.random.Generator, count: int, of_one_robot: bool) -> np.ndarray:
        """(count,) deviations s·ε from the center, or of logarithms."""
        spread = self.values["spread"]
        uncertainty = self.values["center_uncertainty"]
        if of_one_robot:
            return spread * rng.standard_normal(count) + uncertainty * rng.standard_normal()
        return np.hypot(spread, uncertainty) * rng.standard_normal(count)


def distributions_of(
    tables: Mapping[str, Any],
    family: Family,
    where: str | Path,
    remedy: str,
    with_sources: bool = False,
) -> dict[str, Distribution]:
    """Distributions by parameter.

    Args:
        tables: as in `Fleet.summary` or, ``with_sources``, of a fleet file.
        family: of the motors.
        where: the file, for errors.
        remedy: for errors.
        with_sources: whether every table has a unit and a source.

    Raises ArtifactError for unknown or missing keys, a wrong unit, or a value out of range.
    """
    parameters = dict.fromkeys(family.units, TABLE)
    Schema(parameters, remedy, family.optional, "parameters").check(tables, where)
    return {
        name: _distribution(name, tables[name], family, f"{where}[{name}]", remedy, with_sources)
        for name in family.units
        if name in tables
    }


def _distribution(
    name: str,
    table: Mapping[str, Any],
    family: Family,
    where: str,
    remedy: str,
    with_sources: bool,
) -> Distribution:
    """The distribution of one parameter from its table."""
    form_key = "distribution" if with_sources else "kind"
    form: Any = table.get(form_key)
    require(form_key, form, one_of(*_KEYS_OF_FORM), where, remedy)

    entries: dict[str, Field] = {form_key: TEXT}
    if with_sources:
        entries["unit"] = exactly(family.units[name])
        entries["source"] = TEXT
    numbers = _number_fields(form, name, family)
    Schema(entries | numbers, remedy, _OPTIONAL_KEYS).check(table, where)

    values = {key: float(table[key]) for key in numbers if key in table}
    if form == "normal" and name in family.positive and not values.get("minimum", 0.0) > 0:
        raise ArtifactError(
            "a normal distribution can give values that are not above 0",
            where=where,
            remedy="give a minimum above 0, or use lognormal",
        )
    if form == "uniform" and values["low"] > values["high"]:
        raise ArtifactError(
            f"low {values['low']} exceeds high {values['high']}", where=where, remedy="swap them"
        )
    return Distribution(form, values)


def _number_fields(form: str, name: str, family: Family) -> dict[str, Field]:
    """Declarations of the numbers of a parameter's table."""
    low, high = family.bounds(name)
    unit = family.units[name].removesuffix("1")
    above = 0.0 if name in family.positive else -inf
    center = number(low, high, above=above, unit=unit)

    # the spread of a lognormal distribution is that of the logarithm
    spread = number(0.0, high, unit=unit)
    if form == "lognormal":
        spread = number(0.0, _MAX_LOG_SPREAD, unit="of the center")

    declared = {
        "center": center,
        "low": center,
        "high": center,
        "shared": number(0.0, 1.0),
        "spread": spread,
        "center_uncertainty": spread,
        "minimum": number(low, high, unit=unit),
    }
    return {key: declared[key] for key in _KEYS_OF_FORM[form]}
