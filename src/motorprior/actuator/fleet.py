"""A fleet: a population of physical motors, as distributions of their constants in a TOML file with sources."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.constants import COLUMNS, NUM_SAMPLES, Constants
from motorprior.actuator.families import FAMILIES, GEARED, Family, TrueMotors
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_toml, write_text
from motorprior.bounds import (
    TABLE,
    TEXT,
    Field,
    exactly,
    generator_of,
    number,
    one_of,
    require,
    require_count,
)
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import Schema
from motorprior.texts import Overview, Printable

_TEXT_KEYS = ("name", "motor", "robot")
_COMPARE = "compare with a shipped fleet"
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

    constant: center. uniform: [low, high]. normal: center + s·ε, at least ``minimum``. lognormal:
    center·exp(s·ε). s² = spread² (between motors) + center_uncertainty² (of the fit). A fleet clips
    samples to `Family.bounds`.

    Motors of one robot share the sample of center_uncertainty, and of a uniform range the fraction
    ``shared`` (default 0) of the variance: low + (high - low)·Φ(√shared·ε of the robot + √(1 -
    shared)·ε of the motor).
    """

    kind: str
    values: dict[str, float]

    @property
    def center(self) -> float:
        """The value of the fleet's central motor."""
        if self.kind == "uniform":
            return 0.5 * (self.values["low"] + self.values["high"])
        return self.values["center"]

    def sample(
        self, rng: np.random.Generator, count: int, of_one_robot: bool = False
    ) -> np.ndarray:
        """(count,) samples; see `Fleet.sample`."""
        if self.kind == "constant":
            return np.full(count, self.center)
        if self.kind == "uniform":
            low = self.values["low"]
            high = self.values["high"]
            shared = self.values.get("shared", 0.0)
            if not (of_one_robot and shared):
                return rng.uniform(low, high, count)
            from scipy.special import ndtr  # imported here: it takes 0.3 s, and few fleets need it

            robot = rng.standard_normal()
            motors = rng.standard_normal(count)
            return low + (high - low) * ndtr(
                np.sqrt(shared) * robot + np.sqrt(1.0 - shared) * motors
            )
        spread = self.values["spread"]
        uncertainty = self.values["center_uncertainty"]
        if of_one_robot:
            noise = spread * rng.standard_normal(count) + uncertainty * rng.standard_normal()
        else:
            noise = np.hypot(spread, uncertainty) * rng.standard_normal(count)
        if self.kind == "lognormal":
            return self.center * np.exp(noise)
        return np.maximum(self.center + noise, self.values.get("minimum", -np.inf))


@dataclass(frozen=True, repr=False)
class Fleet(Printable):
    """A population of physical motors."""

    name: str
    motor: str
    robot: str
    parameters: dict[str, Distribution]
    family: str = GEARED.name

    def sample(
        self, count: int, seed: int | np.random.Generator, of_one_robot: bool = False
    ) -> TrueMotors:
        """Sample ``count`` motors with a seed, or with a generator to continue.

        Motors ``of_one_robot`` share the uncertainty of the fleet's center, and the shared part of
        a uniform range; otherwise both are sampled per motor. Raises ConfigError for an argument
        out of range, or a motor that cannot be simulated.
        """
        require_count("count", count)
        family = FAMILIES[self.family]
        values = self._values(generator_of(seed), count, of_one_robot)
        family.require_stable(values, f"fleet {self.name}, a sampled motor")
        return family.motors(values)

    def _values(
        self, rng: np.random.Generator, count: int, of_one_robot: bool = False
    ) -> dict[str, np.ndarray]:
        bounds = FAMILIES[self.family].bounds
        return {
            name: np.clip(d.sample(rng, count, of_one_robot), *bounds(name))
            for name, d in self.parameters.items()
        }

    def constants(self) -> Constants:
        """Constants with units and ranges between motors."""
        return Constants.of(
            self._values(np.random.default_rng(0), NUM_SAMPLES), FAMILIES[self.family].units, {}
        )

    def overview(self) -> Overview:
        """For people: robot and constants."""
        facts = {"robot": self.robot, "motor": self.motor, "family": self.family}
        rows = [row[:-1] for row in self.constants().cells]  # true constants
        return Overview(f"fleet {self.name!r} of physical motors", facts, COLUMNS[:-1], rows)

    def center(self, count: int) -> TrueMotors:
        """``count`` copies of the central motor."""
        values = {name: np.full(count, d.center) for name, d in self.parameters.items()}
        return FAMILIES[self.family].motors(values)

    def summary(self) -> dict[str, dict[str, float | str]]:
        """Kind and values of every parameter, for provenance."""
        return {name: {"kind": d.kind, **d.values} for name, d in self.parameters.items()}


def load_fleet(name_or_path: str | Path) -> Fleet:
    """Load a shipped fleet by its name (`Robot.fleets`), or a .toml file.

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value
            out of range.
        ConfigError: its central motor cannot be simulated, see `Family.require_stable`.
    """
    path = fleet_path(name_or_path)
    data = read_toml(path, _COMPARE)
    name = data.pop("family", GEARED.name)
    require("family", name, one_of(*FAMILIES), path, _COMPARE)
    family = FAMILIES[name]
    texts = {key: data.pop(key) for key in _TEXT_KEYS if key in data}
    Schema(dict.fromkeys(_TEXT_KEYS, TEXT), _COMPARE).check(texts, path)
    parameters = distributions_of(data, family, path, _COMPARE, with_sources=True)
    family.require_stable(
        {name: np.array([d.center]) for name, d in parameters.items()}, f"{path}, the central motor"
    )
    return Fleet(**texts, parameters=parameters, family=family.name)


def fleet_path(name_or_path: str | Path) -> Path:
    """The file of a fleet; raises `ArtifactError` if there is none."""
    path = Path(name_or_path)
    shipped = {name: file for robot in SHIPPED for name, file in robot.fleets}
    if path.suffix != ".toml":
        path = Path(shipped.get(str(name_or_path), name_or_path))
    if path.suffix != ".toml" or not path.is_file():
        known = ", ".join(sorted(shipped))
        raise ArtifactError(
            f"no fleet {str(name_or_path)!r}",
            remedy=f"use one of {known}, or a path to a .toml file",
        )
    return path


def distributions_of(
    tables: Mapping[str, Any],
    family: Family,
    where: str | Path,
    remedy: str,
    with_sources: bool = False,
) -> dict[str, Distribution]:
    """Distributions by parameter, from tables as in `Fleet.summary` or, ``with_sources``, of a fleet file.

    Raises ArtifactError for unknown or missing keys, a wrong unit, or a value out of range.
    """
    units = family.units
    kind_key = "distribution" if with_sources else "kind"
    found = {}
    Schema(dict.fromkeys(units, TABLE), remedy, family.optional, "parameters").check(tables, where)
    for name in (name for name in units if name in tables):
        table = tables[name]
        place = f"{where}[{name}]"
        kind = tables[name].get(kind_key)
        require(kind_key, kind, one_of(*_KEYS), place, remedy)
        numbers = _number_fields(kind, name, family)
        texts = {"unit": exactly(units[name]), "source": TEXT} if with_sources else {}
        Schema(
            {kind_key: TEXT, **texts, **numbers}, remedy, frozenset({"minimum", "shared"})
        ).check(table, place)
        values = {key: float(table[key]) for key in numbers if key in table}
        if kind == "normal" and name in family.positive and not values.get("minimum", 0.0) > 0:
            problem = "a normal distribution can give values that are not above 0"
            raise ArtifactError(
                problem, where=place, remedy="give a minimum above 0, or use lognormal"
            )
        if kind == "uniform" and values["low"] > values["high"]:
            raise ArtifactError(
                f"low {values['low']} exceeds high {values['high']}",
                where=place,
                remedy="swap them",
            )
        found[name] = Distribution(kind, values)
    return found


def _number_fields(kind: str, name: str, family: Family) -> dict[str, Field]:
    (low, high), unit = family.bounds(name), family.units[name].removesuffix("1")
    center = number(low, high, above=0.0 if name in family.positive else -inf, unit=unit)
    relative = kind == "lognormal"  # the spread is that of the logarithm
    spread = (
        number(0.0, _MAX_LOG_SPREAD, unit="of the center")
        if relative
        else number(0.0, high, unit=unit)
    )
    shape = {
        "spread": spread,
        "center_uncertainty": spread,
        "minimum": number(low, high, unit=unit),
    }
    return {
        key: shape.get(key, number(0.0, 1.0) if key == "shared" else center) for key in _KEYS[kind]
    }


def write_fleet(path: Path, fleet: Fleet, sources: Mapping[str, str], heading: str) -> None:
    """Write a fleet file with units and sources; ``heading`` is a comment in its first line."""
    texts = {"name": fleet.name, "motor": fleet.motor, "robot": fleet.robot, "family": fleet.family}
    lines = [f"# {heading}", *(f"{key} = {_text(value)}" for key, value in texts.items())]
    for name, distribution in fleet.parameters.items():
        lines += ["", f"[{name}]", f"unit = {_text(FAMILIES[fleet.family].units[name])}"]
        lines += [f"distribution = {_text(distribution.kind)}"]
        lines += [f"{key} = {value!r}" for key, value in distribution.values.items()]
        lines += [f"source = {_text(sources[name])}"]
    write_text(path, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    # a JSON string without ASCII escapes is a TOML basic string
    return json.dumps(value, ensure_ascii=False)


def load_robot_fleet(
    robot: Robot, fleet: Fleet | str | Path | None = None, argument: str = "fleet"
) -> Fleet:
    """A fleet of this robot, by name or path; the one shipped for the robot if None. Errors name the ``argument``.

    Raises:
        ArtifactError: see `load_fleet`.
        ConfigError: a fleet of another robot, or None and no fleet is shipped for the robot.
    """
    chosen = robot.default_fleet if fleet is None else fleet
    try:
        found = chosen if isinstance(chosen, Fleet) else load_fleet(chosen)
    except ArtifactError as error:
        problem = f"{argument}: {error.problem}"
        raise ArtifactError(
            problem, where=error.where, remedy=error.remedy, argument=argument
        ) from error
    if found.robot != robot.name:
        problem = (
            f"{argument} {found.name!r} has motors of robot {found.robot!r}, not {robot.name!r}"
        )
        raise ConfigError(problem, remedy=f"use a fleet of {robot.name}", argument=argument)
    return found


def nominal_pd(fleet: Fleet, num_motors: int) -> IdealPd:
    """An ideal PD with the gains and the torque limit of the fleet's central motor."""
    center = fleet.center(1)
    return IdealPd.uniform(num_motors, center.kp[0], center.kd[0], center.torque_limit[0])


def fleet_files(robot: Robot, fleet: str | None) -> list[Path]:
    """The file of a fleet, by name or path; the robot's own if None."""
    return [fleet_path(robot.default_fleet if fleet is None else fleet)]
