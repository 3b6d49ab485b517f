"""Motors by name: a text such as "pd:kp=9,delay=0.01" or "prior:FILE" chooses a robot's motors.

    NAME[:VALUE][,OPTION=VALUE][,FLAG]        a VALUE without a name is that of the first option

A name stands for a function (robot, options) -> `EpisodeMotors`, registered by `register`. Its
parameters after the robot are the options: numbers, flags (True), or texts (names, and files, which
have a suffix). To add an actuator, add one file to this folder, with its kernels, its `Actuator`
and its function. `ideal_pd` is an example of kernels and `Actuator`, `pd_motors` of functions.
"""

import pkgutil
from collections.abc import Callable
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

import motorprior.actuator
from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError, ConfigError, MotorPriorError, quoted
from motorprior.robots.robot import Robot

DrawMotors: TypeAlias = Callable[[np.random.Generator], Actuator]
"""Draws the motors of one episode, one per joint of the robot."""
Options: TypeAlias = dict[str, Any]


class EpisodeMotors(NamedTuple):
    """The motors of a robot's episodes."""

    draw: DrawMotors
    condition: str = ""  # name of the motors in a study; the registered name if empty
    prior: MotorPrior | None = None  # prior that the motors are samples of


MakeMotors: TypeAlias = Callable[..., EpisodeMotors]
_MAKERS: dict[str, MakeMotors] = {}


def register(name: str) -> Callable[[MakeMotors], MakeMotors]:
    """Decorator of the function that makes the motors of this name."""

    def decorate(make: MakeMotors) -> MakeMotors:
        _MAKERS[name] = make
        return make

    return decorate


def motors_from_text(text: str, robot: Robot) -> tuple[EpisodeMotors, Options]:
    """The motors that a text chooses for a robot, and the given options.

    Raises:
        ConfigError: as `parsed`; or a value out of range, or motors of another robot.
        ArtifactError: a file cannot be read.
    """
    name, options = parsed(text)
    try:
        motors = _MAKERS[name](robot, **options)
    except (ConfigError, ArtifactError) as error:
        if error.where is not None:
            raise
        raise _error(text, error.problem, error.remedy, type(error)) from error
    return motors._replace(condition=motors.condition or name), options


def parsed(text: str) -> tuple[str, Options]:
    """Registered name and given options of a text.

    Raises:
        ConfigError: an unknown name or option, or a missing option.
    """
    _import_makers()
    name, _, rest = text.partition(":")
    if name not in _MAKERS:
        remedy = f"use one of {', '.join(sorted(_MAKERS))}; a shipped prior is prior:NAME"
        raise _error(text, f"no motors {name!r}", remedy)

    parameters = list(signature(_MAKERS[name]).parameters.values())[1:]
    options: Options = {}
    for item in filter(None, rest.split(",")):
        option, value = _option(item, parameters)
        if option not in [parameter.name for parameter in parameters] or option in options:
            remedy = f"{name} has {', '.join(parameter.name for parameter in parameters) or 'none'}"
            raise _error(text, f"unknown or repeated option {item!r}", remedy)
        options[option] = value

    for parameter in parameters:
        if parameter.default is Parameter.empty and parameter.name not in options:
            remedy = f"give {parameter.name}=FILE"
            raise _error(text, f"{parameter.name} is missing", remedy)
    return name, options


def _import_makers() -> None:
    """Import every module of this folder, which registers its motors."""
    for module in pkgutil.iter_modules(motorprior.actuator.__path__):
        import_module(f"motorprior.actuator.{module.name}")


def _option(item: str, parameters: list[Parameter]) -> tuple[str, float | str | bool]:
    """Name and value of an item such as "kp=9", "limit_follows_gain" or "prior.safetensors"."""
    option, separator, value = item.partition("=")
    names = [parameter.name for parameter in parameters]
    if option.isidentifier() and separator:
        return option, _number_or_text(value)
    if item in names:
        return item, True
    first_option = names[0] if names else item
    return first_option, _number_or_text(item)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def file_options(options: Options) -> list[str]:
    """Names of the options that are files."""
    return [
        name for name, value in options.items() if isinstance(value, str) and Path(value).suffix
    ]


def motor_text(name: str, **options: float | Path | str | None) -> str:
    """The text that chooses motors by name; options that are None or False are left out."""
    items = []
    for option, value in options.items():
        if value is None or value is False:
            continue
        items.append(option if value is True else f"{option}={value}")
    return f"{name}:{','.join(items)}" if items else name


def _error(
    text: str,
    problem: str,
    remedy: str | None,
    error_type: type[MotorPriorError] = ConfigError,
) -> MotorPriorError:
    return error_type(f"motors {quoted(text, 80)}: {problem}", remedy=remedy, argument="motors")
