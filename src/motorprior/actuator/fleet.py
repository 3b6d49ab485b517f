"""A fleet: a population of physical motors, as distributions of their constants.

Fleets are TOML files that state a source of every distribution.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.constants import COLUMNS, NUM_SAMPLES, Constants
from motorprior.actuator.distribution import Distribution, distributions_of
from motorprior.actuator.families import FAMILIES, GEARED, TrueMotors
from motorprior.actuator.generic_fleet import generic_parameters
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_toml, write_text
from motorprior.bounds import TEXT, generator_of, one_of, require, require_count
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import Schema
from motorprior.texts import Overview, Printable

_TEXT_KEYS = ("name", "motor", "robot")
_COMPARE = "compare with a shipped fleet"


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
        """(count,) samples of every parameter, clipped to the bounds of the family."""
        family = FAMILIES[self.family]
        values = {}
        for name, distribution in self.parameters.items():
            low, high = family.bounds(name)
            values[name] = np.clip(distribution.sample(rng, count, of_one_robot), low, high)
        return values

    def constants(self) -> Constants:
        """Constants with units and ranges between motors."""
        values = self._values(np.random.default_rng(0), NUM_SAMPLES)
        return Constants.of(values, FAMILIES[self.family].units, {})

    def overview(self) -> Overview:
        """For people: robot and constants."""
        facts = {"robot": self.robot, "motor": self.motor, "family": self.family}
        rows = [row[:-1] for row in self.constants().cells]  # true constants
        return Overview(f"fleet {self.name!r} of physical motors", facts, COLUMNS[:-1], rows)

    def center(self, count: int) -> TrueMotors:
        """``count`` copies of the central motor."""
        values = {
            name: np.full(count, distribution.center)
            for name, distribution in self.parameters.items()
        }
        return FAMILIES[self.family].motors(values)

    def summary(self) -> dict[str, dict[str, float | str]]:
        """Form (key ``kind``) and values of every parameter's distribution, for provenance."""
        return {
            name: {"kind": distribution.form, **distribution.values}
            for name, distribution in self.parameters.items()
        }


def load_fleet(name_or_path: str | Path) -> Fleet:
    """Load a shipped fleet by its name (`Robot.fleets`), or a .toml file.

    Raises:
        ArtifactError: unknown name, invalid TOML, unknown or missing keys, wrong unit, or a value
            out of range.
        ConfigError: its central motor is unstable at the steps of its simulation.
    """
    path = fleet_path(name_or_path)
    data = read_toml(path, _COMPARE)

    family_name = data.pop("family", GEARED.name)
    require("family", family_name, one_of(*FAMILIES), path, _COMPARE)
    family = FAMILIES[family_name]

    texts = {key: data.pop(key) for key in _TEXT_KEYS if key in data}
    Schema(dict.fromkeys(_TEXT_KEYS, TEXT), _COMPARE).check(texts, path)

    parameters = distributions_of(data, family, path, _COMPARE, with_sources=True)
    center = {name: np.array([parameter.center]) for name, parameter in parameters.items()}
    family.require_stable(center, f"{path}, the central motor")
    return Fleet(**texts, parameters=parameters, family=family.name)


def generic_fleet(robot: Robot) -> Fleet:
    """A wide fleet for a robot of whose motors only gains and torque limits are known.

    Armature, friction and gear scale with the gain, see `generic_fleet.generic_parameters`. Raises
    ConfigError if such motors cannot be simulated.
    """
    parameters = generic_parameters(robot)
    center = {name: np.array([parameter.center]) for name, parameter in parameters.items()}
    GEARED.require_stable(center, f"the generic fleet of {robot.name}")
    return Fleet("generic", robot.motor, robot.name, parameters)


def fleet_path(name_or_path: str | Path) -> Path:
    """The file of a fleet; raises `ArtifactError` if there is none."""
    shipped = {name: file for robot in SHIPPED for name, file in robot.fleets}
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = Path(shipped.get(str(name_or_path), name_or_path))
    if path.suffix != ".toml" or not path.is_file():
        names = ", ".join(sorted(shipped))
        raise ArtifactError(
            f"no fleet {str(name_or_path)!r}",
            remedy=f"use one of {names}, or a path to a .toml file",
        )
    return path


def write_fleet(path: Path, fleet: Fleet, sources: Mapping[str, str], heading: str) -> None:
    """Write a fleet file with units and sources; ``heading`` is a comment in its first line."""
    units = FAMILIES[fleet.family].units
    lines = [
        f"# {heading}",
        f"name = {_text(fleet.name)}",
        f"motor = {_text(fleet.motor)}",
        f"robot = {_text(fleet.robot)}",
        f"family = {_text(fleet.family)}",
    ]
    for name, distribution in fleet.parameters.items():
        lines.append("")
        lines.append(f"[{name}]")
        lines.append(f"unit = {_text(units[name])}")
        lines.append(f"distribution = {_text(distribution.form)}")
        for key, value in distribution.values.items():
            lines.append(f"{key} = {value!r}")
        lines.append(f"source = {_text(sources[name])}")
    write_text(path, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    # a JSON string without ASCII escapes is a TOML basic string
    return json.dumps(value, ensure_ascii=False)


def load_robot_fleet(
    robot: Robot, fleet: Fleet | str | Path | None = None, argument: str = "fleet"
) -> Fleet:
    """A fleet of this robot.

    Args:
        robot: of the motors.
        fleet: a fleet, or its name or path; if None, the one shipped for the robot, or else its
            `generic_fleet`.
        argument: name of the argument that errors state.

    Raises:
        ArtifactError: see `load_fleet`.
        ConfigError: a fleet of another robot.
    """
    if fleet is None and not robot.fleets:
        return generic_fleet(robot)
    if fleet is None:
        fleet = robot.default_fleet
    if not isinstance(fleet, Fleet):
        fleet = _load_argument(fleet, argument)
    if fleet.robot != robot.name:
        raise ConfigError(
            f"{argument} {fleet.name!r} has motors of robot {fleet.robot!r}, not {robot.name!r}",
            remedy=f"use a fleet of {robot.name}",
            argument=argument,
        )
    return fleet


def _load_argument(name_or_path: str | Path, argument: str) -> Fleet:
    """`load_fleet`, with errors that name the argument."""
    try:
        return load_fleet(name_or_path)
    except ArtifactError as error:
        raise ArtifactError(
            f"{argument}: {error.problem}",
            where=error.where,
            remedy=error.remedy,
            argument=argument,
        ) from error


def nominal_pd(fleet: Fleet, num_motors: int) -> IdealPd:
    """An ideal PD with the gains and the torque limit of the fleet's central motor."""
    center = fleet.center(1)
    return IdealPd.uniform(num_motors, center.kp[0], center.kd[0], center.torque_limit[0])


def fleet_files(robot: Robot, fleet: str | None) -> list[Path]:
    """The file of a fleet, by name or path; the robot's own if None.

    There is none for the generic fleet, which follows from the files of the robot.
    """
    if fleet is None and not robot.fleets:
        return []
    return [fleet_path(robot.default_fleet if fleet is None else fleet)]
