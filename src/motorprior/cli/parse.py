"""From the words of a command line to a command and its settings, and the list of commands."""

from difflib import get_close_matches
from typing import Any

from motorprior import __version__
from motorprior.cli.command_table import COMMANDS, LOGS, Command, available_commands
from motorprior.exceptions import ConfigError

_HELP = ("-h", "--help", "--help-all")
_DESCRIPTION = "Identify motors from logs, train walking policies on them, evaluate and deploy."


def parse(words: list[str]) -> tuple[Command, Any]:
    """Command and settings of a command line, without the word `motorprior`.

    Raises ConfigError for an unknown command, an unknown option or an empty list of files, and
    SystemExit after help and version (code 0) or a wrong value (code 2).
    """
    if words == ["--version"]:
        print(f"motorprior {__version__}")
        raise SystemExit(0)

    group = LOGS if words[:1] == [LOGS.strip()] else ""
    words_of_group = words[1:] if group else words
    if not words_of_group or words_of_group[0] in _HELP:
        print(list_of_commands(group))
        raise SystemExit(0 if words_of_group else 2)

    word, *options = words_of_group
    name = group + word
    if name not in COMMANDS:
        raise _unknown_command(word, group)

    from motorprior.cli.options import parse_options  # here: the list of commands needs no tyro

    command = COMMANDS[name]
    return command, parse_options(command, name, options)


def list_of_commands(group: str = "") -> str:
    """The help of `motorprior`, or of the commands whose names begin with ``group``."""
    commands = _commands_of(group)
    width = max(len(name) for name in commands)
    lines = [f"  {name.ljust(width)}  {command.help}" for name, command in commands.items()]
    usage = f"usage: motorprior {group}COMMAND [OPTIONS]"
    help_of_options = (
        f"Options of a command: motorprior {group}COMMAND --help; all of its options: --help-all."
    )
    return "\n".join([usage, "", _DESCRIPTION, "", "commands:", *lines, "", help_of_options])


def _commands_of(group: str) -> dict[str, Command]:
    """The commands whose names begin with ``group``, by the rest of their names."""
    return {
        name.removeprefix(group): command
        for name, command in available_commands().items()
        if name.startswith(group)
    }


def _unknown_command(word: str, group: str) -> ConfigError:
    names = list(_commands_of(group))
    nearest = get_close_matches(word, names, 2)
    suggestion = " or ".join(nearest) if nearest else f"one of {', '.join(names)}"
    return ConfigError(
        f"no command {word!r}", remedy=f"did you mean {suggestion}? --help lists them"
    )
