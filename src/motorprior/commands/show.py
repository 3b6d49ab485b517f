"""What a file holds."""

from dataclasses import dataclass
from pathlib import Path

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior, card_file
from motorprior.artifacts import read_tensors, read_toml
from motorprior.exceptions import ArtifactError
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.locomotion.policy import Policy
from motorprior.logs.read_log import read_log
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import SHIPPED


@dataclass(frozen=True)
class Show:
    """Print what a file holds, such as a prior's constants."""

    file: Path
    """A .safetensors of identify, adapt, walk or excite, a log in any format, a .toml file of a
    fleet or robot, or a shipped fleet or motor card by name."""
    prior: Path | None = None
    """The prior of a posterior, for its constants."""
    columns: str | None = None
    """Column map of a table: a shipped one by name, or your .toml file."""


def content(config: Show) -> object:
    """The object in the file: robot, fleet, prior, posterior, excitation, policy or log."""
    path = config.file
    shipped_fleets = {name for robot in SHIPPED for name, _ in robot.fleets}
    if str(path) in shipped_fleets:
        return load_fleet(path)
    if path.suffix == ".toml":
        table = read_toml(path, "give the .toml file of a robot or a fleet")
        return load_robot(path) if "model" in table else load_fleet(path)
    if card_file(str(path)):
        return MotorPrior.load(path)
    if path.suffix == ".safetensors":
        return _content_of_tensors(path, config.prior)
    return read_log(path, None, config.columns)


def _content_of_tensors(path: Path, prior: Path | None) -> object:
    _, header = read_tensors(path)
    artefact_name = header.get("kind")
    match artefact_name:
        case "motor prior":
            return MotorPrior.load(path)
        case "excitation":
            return LearnedExcitation.load(path)
        case "motor posterior":
            if prior is None:
                raise ArtifactError(
                    "a posterior needs its prior",
                    where=path,
                    remedy=f"give it: motorprior show {path} --prior prior.safetensors",
                    argument="prior",
                )
            return MotorPosterior.load(path, MotorPrior.load(prior))
        case _:
            return Policy.load(path)
