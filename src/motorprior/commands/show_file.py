"""What a file holds: a motor log, a prior, a posterior, a policy or a fleet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior, card_file
from motorprior.artifacts import read_tensors
from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ArtifactError
from motorprior.locomotion.policy import Policy
from motorprior.logs.read_log import read_log
from motorprior.robots.shipped import SHIPPED


@dataclass(frozen=True)
class Show:
    """Print what a file holds: constants of a prior, posterior or fleet with units and ranges, a log, or a policy."""

    file: Path
    """A .safetensors of identify, adapt or walk, a log in any format, a fleet's .toml file, or a shipped fleet or motor
    card by name."""
    prior: Path | None = None
    """The prior of a posterior, for its constants."""
    columns: str | None = None
    """Column map of a table: a shipped one by name, or your .toml file."""


def described(config: Show) -> str:
    """The text; raises ArtifactError, LogError or ConfigError for a file that cannot be read."""
    path = config.file
    if path.suffix == ".toml" or str(path) in {name for robot in SHIPPED for name, _ in robot.fleets}:
        return str(load_fleet(path))
    if card_file(str(path)):
        return str(MotorPrior.load(path))
    if path.suffix != ".safetensors":
        return str(read_log(path, None, config.columns))
    kind = str(read_tensors(path)[1].get("kind"))
    if kind == "motor prior":
        return str(MotorPrior.load(path))
    if kind != "motor posterior":
        return str(Policy.load(path))
    if config.prior is None:
        remedy = f"give it: motorprior show {path} --prior prior.safetensors"
        raise ArtifactError("a posterior needs its prior", where=path, remedy=remedy, argument="prior")
    return str(MotorPosterior.load(path, MotorPrior.load(config.prior)))
