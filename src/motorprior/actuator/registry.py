"""Motors by name: a text such as "pd:kp=9,delay=0.01" or "prior:FILE" chooses the motors of a simulated robot.

    KIND[:VALUE][,OPTION=VALUE][,FLAG]        a VALUE without a name is that of the first option

A kind is a function (robot, options) -> `EpisodeMotors`, registered by `register`. Its parameters
after the robot are the options: numbers, flags (True), or texts (names, and files, which have a
suffix). To add an actuator, add one file to this folder, with its kernels, its `Actuator` and its
kind.
"""

import pkgutil
from collections.abc import Callable
from importlib import import_module
from inspect import signature
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
    condition: str = ""  # name in a study; that of the kind if empty
    prior: MotorPrior | None = None  # that the motors are samples of


KINDS: dict[str, Callable[..., EpisodeMotors]] = {}


def register(kind: str) -> Callable[[Callable[..., EpisodeMotors]], Callable[..., EpisodeMotors]]:
    """Decorator of the function that makes the motors of this kind."""

    def decorate(function: Callable[..., EpisodeMotors]) -> Callable[..., EpisodeMotors]:
        KINDS[kind] = function
        return function

    return decorate


def motors_from_text(text: str, robot: Robot) -> tuple[EpisodeMotors, Options]:
    """The motors that a text chooses for a robot, and the given options.

    Errors as in `parsed`, and for a value out of range, an unreadable file, or motors of another
    robot.
    """
    kind, options = parsed(text)
    try:
        found = KINDS[kind](robot, **options)
    except (ConfigError, ArtifactError) as error:
        if error.where is not None:
            raise
        raise _error(text, error.problem, error.remedy, type(error)) from error
    return found._replace(condition=found.condition or kind), options


def parsed(text: str) -> tuple[str, Options]:
    """Kind and given options of a text; ConfigError for an unknown kind or option, or a missing option."""
    for module in pkgutil.iter_modules(motorprior.actuator.__path__):
        import_module(f"motorprior.actuator.{module.name}")
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise _error(
            text,
            f"no kind {kind!r}",
            f"use one of {', '.join(KINDS)}; a shipped prior is prior:NAME",
        )
    parameters = list(signature(KINDS[kind]).parameters.values())[1:]
    names = [each.name for each in parameters]
    options = {}
    for item in filter(None, rest.split(",")):
        option, separator, value = item.partition("=")
        if not option.isidentifier() or (not separator and item not in names):
            option = names[0] if names else item
            separator = "="
            value = item
        if option not in names or option in options:
            raise _error(
                text,
                f"unknown or repeated option {item!r}",
                f"{kind} has {', '.join(names) or 'none'}",
            )
        options[option] = _value(value) if separator else True
    for each in parameters:
        if each.default is each.empty and each.name not in options:
            raise _error(text, f"{each.name} is missing", f"give {each.name}=FILE")
    return kind, options


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def file_options(options: Options) -> list[str]:
    """Names of the options that are files."""
    return [
        name for name, value in options.items() if isinstance(value, str) and Path(value).suffix
    ]


def motor_text(kind: str, **options: float | Path | str | None) -> str:
    """The text that chooses motors of a kind; options that are None or False are left out."""
    given = {
        option: value
        for option, value in options.items()
        if value is not None and value is not False
    }
    items = [option if value is True else f"{option}={value}" for option, value in given.items()]
    return ":".join([kind, ",".join(items)][: 1 + bool(items)])


def _error(
    text: str, problem: str, remedy: str | None, kind: type[MotorPriorError] = ConfigError
) -> MotorPriorError:
    return kind(f"motors {quoted(text, 80)}: {problem}", remedy=remedy, argument="motors")
