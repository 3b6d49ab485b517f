"""Words of a command line that its command does not know, with what the user may have meant."""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any, get_type_hints

from motorprior.cli.command_table import Command, available_commands
from motorprior.exceptions import ConfigError, listed


def unknown_word(command: Command, words: Sequence[str], unknown: str) -> ConfigError:
    """Error for a word of ``words`` that is neither an option of the command nor its value."""
    options = _options(command.load_settings())
    if not unknown.startswith("-"):
        return _stray_value(options, words, unknown)

    option = unknown.partition("=")[0]
    nearest = get_close_matches(option, options, 1, 0.75)
    if nearest and nearest[0].removeprefix("--").replace("-", "_") in command.positional:
        remedy = f"give the values without {nearest[0]}"
    elif nearest:
        remedy = f"did you mean {nearest[0]}?"
    else:
        others = _commands_with(option)
        remedy = "--help-all lists the options"
        if others:
            remedy = f"it is an option of {listed(others, 4)}; {remedy}"
    return ConfigError(f"no option {option}", remedy=remedy)


def _commands_with(option: str) -> list[str]:
    """Names of the commands that have an option."""
    names = []
    for name, command in available_commands().items():
        try:
            settings = command.load_settings()
        except ModuleNotFoundError:  # a command for Linux and macOS, on Windows
            continue
        if option in _options(settings):
            names.append(name)
    return names


def _stray_value(options: dict[str, Any], words: Sequence[str], unknown: str) -> ConfigError:
    index = list(words).index(unknown)
    previous = words[index - 1] if index else ""
    if options.get(previous) is bool:
        problem = f"{unknown!r} after {previous}, which takes no value"
    else:
        problem = f"{unknown!r} is the value of no option"

    from motorprior.robots.shipped import SHIPPED

    is_robot = unknown.endswith(".toml") or unknown in {robot.name for robot in SHIPPED}
    if is_robot and "--robot" in options:
        return ConfigError(problem, remedy=f"name the robot with --robot {unknown}")
    return ConfigError(problem, remedy="remove it; --help-all lists the options")


def _options(settings: type, prefix: str = "--") -> dict[str, Any]:
    """Type of every option by its name; --no-X stands for a flag --X, too."""
    hints = get_type_hints(settings)
    options: dict[str, Any] = {}
    for setting in fields(settings):
        hint = hints[setting.name]
        option = prefix + setting.name.replace("_", "-")
        if isinstance(hint, type) and is_dataclass(hint):
            options |= _options(hint, f"{option}.")
            continue
        options[option] = hint
        if hint is bool:
            words = option.removeprefix("--").split(".")
            options["--" + ".".join([*words[:-1], f"no-{words[-1]}"])] = bool
    return options
