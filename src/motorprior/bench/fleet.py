"""A fleet: the population that true motors are drawn from, as a TOML file with units and sources."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.kernels import ActuatorKind
from motorprior.artifacts import write_text
from motorprior.bench.distribution import Distribution, bounds_of, distribution_of
from motorprior.bench.families import FAMILIES, GEARED, Family, TrueMotors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError
from motorprior.files import read_toml
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import TABLE, TEXT, Schema, exactly, one_of, require

_TEXT_KEYS = ("name", "motor", "robot")
_COMPARE = "compare with a shipped fleet"


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
            of_one_robot: the uncertainty of the fleet's center, and the shared part of a uniform range, are the same
                for all motors; otherwise they are drawn for every motor.

        Raises:
            ConfigError: an argument out of range, or a motor that cannot be simulated.
        """
        require_count("count", count)
        rng, family = generator_of(seed), FAMILIES[self.family]
        values = {
            name: np.clip(d.sample(rng, count, of_one_robot), *bounds_of(name, family))
            for name, d in self.parameters.items()
        }
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

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value out of range.
        ConfigError: its central motor cannot be simulated, see `Family.require_stable`.
    """
    path = fleet_path(name_or_path)
    data = read_toml(path, _COMPARE)
    name = data.pop("family", GEARED.name)
    require("family", name, one_of(*FAMILIES), path, _COMPARE)
    family = FAMILIES[name]
    tables = dict.fromkeys(family.units, TABLE)
    Schema(dict.fromkeys(_TEXT_KEYS, TEXT) | tables, _COMPARE, family.optional).check(data, path)
    parameters = {}
    for name, unit in family.units.items():
        if name in data:
            others, where = {"unit": exactly(unit), "source": TEXT}, f"{path}[{name}]"
            parameters[name] = distribution_of(data[name], "distribution", others, name, family, where, _COMPARE)
    family.require_stable({name: np.array([d.center]) for name, d in parameters.items()}, f"{path}, its central motor")
    return Fleet(**{key: data[key] for key in _TEXT_KEYS}, parameters=parameters, family=family.name)


def fleet_path(name_or_path: str | Path) -> Path:
    """The file of a fleet; raises `ArtifactError` if there is none."""
    path, shipped = Path(name_or_path), {name: file for robot in SHIPPED for name, file in robot.fleets}
    if path.suffix != ".toml":
        path = Path(shipped.get(str(name_or_path), name_or_path))
    if path.suffix != ".toml" or not path.is_file():
        known = ", ".join(sorted(shipped))
        raise ArtifactError(f"no fleet {name_or_path!r}", remedy=f"use one of {known}, or a path to a .toml file")
    return path


def fleet_of(
    name: str, motor: str, robot: str, parameters: Mapping[str, Mapping[str, Any]], where: str, family: Family = GEARED
) -> Fleet:
    """The fleet that `Fleet.summary` describes; raises `ArtifactError` for wrong keys or values out of range."""
    remedy = "record the bench again"
    Schema(dict.fromkeys(family.units, TABLE), remedy, family.optional, "parameters").check(parameters, where)
    made = {
        parameter: distribution_of(
            parameters[parameter], "kind", {}, parameter, family, f"{where}[{parameter}]", remedy
        )
        for parameter in family.units
        if parameter in parameters
    }
    return Fleet(name, motor, robot, made, family.name)


def write_fleet(path: Path, fleet: Fleet, sources: Mapping[str, str], heading: str) -> None:
    """Write every parameter with its unit and its source to a .toml file, below a line of ``heading``."""
    texts = {"name": fleet.name, "motor": fleet.motor, "robot": fleet.robot, "family": fleet.family}
    lines = [f"# {heading}", *(f"{key} = {_text(value)}" for key, value in texts.items())]
    for name, distribution in fleet.parameters.items():
        lines += ["", f"[{name}]", f"unit = {_text(FAMILIES[fleet.family].units[name])}"]
        lines += [f"distribution = {_text(distribution.kind)}"]
        lines += [f"{key} = {value!r}" for key, value in distribution.values.items()]
        lines += [f"source = {_text(sources[name])}"]
    write_text(path, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)  # a JSON string without ASCII escapes is a TOML basic string
