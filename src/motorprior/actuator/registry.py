"""Motors by name: a text such as "pd:kp=9,delay=0.01" or "prior:FILE" chooses the motors of a simulated robot.

    KIND[:VALUE][,OPTION=VALUE][,FLAG]        VALUE without a name is that of the first option

A kind is a function with `register`, (robot, options) -> `Drawn`. Its parameters after the robot are the options, of
the types float, bool (a flag) and Path (a file if it has a suffix, otherwise a name). A new actuator is one file of
this folder: its kernels, its `Actuator`, and its kind.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, get_args, get_type_hints

import numpy as np

import motorprior.actuator
from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bounds import is_number
from motorprior.exceptions import ArtifactError, ConfigError, quoted
from motorprior.robots.robot import Robot

DrawMotors: TypeAlias = Callable[[np.random.Generator], Actuator]
"""Draws the motors of one episode, one per joint of the robot."""
Options: TypeAlias = dict[str, "float | bool | Path"]


class Drawn(NamedTuple):
    """The motors of a robot's episodes."""

    draw: DrawMotors
    condition: str = ""  # name in a study; that of the kind if empty
    prior: MotorPrior | None = None  # that the motors are samples of


KINDS: dict[str, Callable[..., Drawn]] = {}


def register(kind: str) -> Callable[[Callable[..., Drawn]], Callable[..., Drawn]]:
    """Decorator of the function that makes the motors of this kind."""

    def decorate(function: Callable[..., Drawn]) -> Callable[..., Drawn]:
        KINDS[kind] = function
        return function

    return decorate


def drawn(text: str, robot: Robot) -> tuple[Drawn, Options]:
    """The motors that a text chooses for a robot, and the given options.

    Raises:
        ConfigError, ArtifactError: see `parsed`; a value out of range, a file that cannot be read, or motors of another
            robot.
    """
    kind, options = parsed(text)
    try:
        found = KINDS[kind](robot, **options)
    except (ConfigError, ArtifactError) as error:
        if error.where is not None:
            raise
        raise type(error)(_in(text, error.problem), remedy=error.remedy, argument="motors") from error
    return found._replace(condition=found.condition or kind), options


def parsed(text: str) -> tuple[str, Options]:
    """Kind and given options of a text.

    Raises:
        ConfigError: an unknown kind or option, a missing option, or a value of another type.
    """
    for module in pkgutil.iter_modules(motorprior.actuator.__path__):
        import_module(f"motorprior.actuator.{module.name}")
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise _error(text, f"no kind {kind!r}", f"use one of {', '.join(KINDS)}")
    hints, values = get_type_hints(KINDS[kind]), {}
    parameters = list(signature(KINDS[kind]).parameters.values())[1:]
    types: dict[str, Any] = {each.name: get_args(hints[each.name]) or (hints[each.name],) for each in parameters}
    for item in filter(None, rest.split(",")):
        option, separator, value = item.partition("=")
        if (not separator and bool not in types.get(option, ())) or not option.isidentifier():
            option, value = next(iter(types)), item
        if option not in types or option in values:
            raise _error(text, f"unknown or repeated option {item!r}", f"{kind} has {', '.join(types)}")
        values[option] = _value(text, option, value, types[option])
    for each in parameters:
        if each.default is each.empty and each.name not in values:
            raise _error(text, f"{each.name} is missing", f"give {each.name}=FILE")
    return kind, values


def _value(text: str, option: str, value: str, types: tuple[Any, ...]) -> float | bool | Path:
    if Path in types:
        return Path(value)
    if bool in types:
        return True
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not is_number(number):
        raise _error(text, f"{option} {quoted(value)} is not a finite number", "give a number")
    return number


def file_options(options: Options) -> list[str]:
    """Names of the options that are files."""
    return [name for name, value in options.items() if isinstance(value, Path) and value.suffix]


def motor_text(kind: str, **options: float | Path | str | None) -> str:
    """The text that chooses motors of a kind; options that are None or False are left out."""
    given = {option: value for option, value in options.items() if value is not None and value is not False}
    items = [option if value is True else f"{option}={value}" for option, value in given.items()]
    return ":".join([kind, ",".join(items)][: 1 + bool(items)])


def _error(text: str, problem: str, remedy: str) -> ConfigError:
    return ConfigError(_in(text, problem), remedy=remedy, argument="motors")


def _in(text: str, problem: str) -> str:
    return f"motors {quoted(text, 80)}: {problem}"
