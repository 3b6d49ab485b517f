"""A fleet: a population of physical motors, as a TOML file with units and sources."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.kernels import ActuatorKind
from motorprior.artifacts import write_text
from motorprior.bench.distribution import Distribution, bounds_of, distributions_of
from motorprior.bench.families import FAMILIES, GEARED, TrueMotors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError
from motorprior.files import read_toml
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import TEXT, Schema, one_of, require

_TEXT_KEYS = ("name", "motor", "robot")
_COMPARE = "compare with a shipped fleet"


@dataclass(frozen=True)
class Fleet:
    """A population of physical motors."""

    name: str
    motor: str
    robot: str
    parameters: dict[str, Distribution]
    family: str = GEARED.name

    @property
    def kind(self) -> ActuatorKind:
        """Of its motors."""
        return FAMILIES[self.family].kind

    def sample(self, count: int, seed: int | np.random.Generator, of_one_robot: bool = False) -> TrueMotors:
        """Sample ``count`` motors.

        Args:
            count: number of motors.
            seed: seed, or a generator to continue.
            of_one_robot: the uncertainty of the fleet's center, and the shared part of a uniform range, are the same
                for all motors; otherwise they are sampled per motor.

        Raises:
            ConfigError: an argument out of range, or a motor that cannot be simulated.
        """
        require_count("count", count)
        rng, family = generator_of(seed), FAMILIES[self.family]
        values = {
            name: np.clip(d.sample(rng, count, of_one_robot), *bounds_of(name, family))
            for name, d in self.parameters.items()
        }
        family.require_stable(values, f"fleet {self.name}, a sampled motor")
        return family.motors(values)

    def center(self, count: int) -> TrueMotors:
        """``count`` copies of the central motor."""
        values = {name: np.full(count, d.center) for name, d in self.parameters.items()}
        return FAMILIES[self.family].motors(values)

    def summary(self) -> dict[str, dict[str, float | str]]:
        """Kind and values of every parameter, for provenance."""
        return {name: {"kind": d.kind, **d.values} for name, d in self.parameters.items()}


def load_fleet(name_or_path: str | Path) -> Fleet:
    """Load a fleet.

    Args:
        name_or_path: name of a shipped fleet (`Robot.fleets`), or path of a .toml file.

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value out of range.
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
    family.require_stable({name: np.array([d.center]) for name, d in parameters.items()}, f"{path}, the central motor")
    return Fleet(**texts, parameters=parameters, family=family.name)


def fleet_path(name_or_path: str | Path) -> Path:
    """The file of a fleet; raises `ArtifactError` if there is none."""
    path, shipped = Path(name_or_path), {name: file for robot in SHIPPED for name, file in robot.fleets}
    if path.suffix != ".toml":
        path = Path(shipped.get(str(name_or_path), name_or_path))
    if path.suffix != ".toml" or not path.is_file():
        known = ", ".join(sorted(shipped))
        raise ArtifactError(f"no fleet {name_or_path!r}", remedy=f"use one of {known}, or a path to a .toml file")
    return path


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
    return json.dumps(value, ensure_ascii=False)  # a JSON string without ASCII escapes is a TOML basic string
