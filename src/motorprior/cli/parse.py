"""From the words of a command line to a command and its settings, and the help."""

from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, make_dataclass
from difflib import get_close_matches
from typing import Any, get_type_hints

import tyro

from motorprior import __version__
from motorprior.cli.command_table import COMMANDS, LOGS, Command, available_commands
from motorprior.exceptions import ConfigError

HELP_ALL = "--help-all"
_HELP = ("-h", "--help")
_DESCRIPTION = "Identify motors from logs, train walking policies on them, evaluate and deploy."


def parse(words: list[str]) -> tuple[Command, Any]:
    """Command and settings of a command line, without the word `motorprior`.

    Raises ConfigError for an unknown command or an empty list of files, and SystemExit after help
    and version (code 0) or a wrong option (code 2).
    """
    if words == ["--version"]:
        print(f"motorprior {__version__}")
        raise SystemExit(0)

    group = LOGS if words[:1] == [LOGS.strip()] else ""
    first_word = 1 if group else 0
    command_words = words[first_word : first_word + 1]
    options = words[first_word + 1 :]
    if not command_words or command_words[0] in (*_HELP, HELP_ALL):
        print(list_of_commands(group))
        raise SystemExit(0 if command_words else 2)

    name = group + command_words[0]
    if name not in COMMANDS:
        raise _unknown_command(command_words[0], group)

    command = COMMANDS[name]
    show_all = HELP_ALL in options or not set(_HELP) & set(options)
    declaration = _declaration(command, show_all)
    tyro_words = ["--help" if word == HELP_ALL else word for word in options]
    settings = tyro.cli(declaration, prog=f"motorprior {name}", args=tyro_words)
    _require_files(settings)
    return command, settings


def list_of_commands(group: str = "") -> str:
    """The help of `motorprior`, or of the commands whose names begin with ``group``."""
    commands = {
        name.removeprefix(group): command.help
        for name, command in available_commands().items()
        if name.startswith(group)
    }
    width = max(len(name) for name in commands)
    lines = [f"  {name.ljust(width)}  {text}" for name, text in commands.items()]
    usage = f"usage: motorprior {group}COMMAND [OPTIONS]"
    options = (
        f"Options of a command: motorprior {group}COMMAND --help; "
        f"all of its options: {HELP_ALL}. Version: motorprior --version."
    )
    return "\n".join([usage, "", _DESCRIPTION, "", "commands:", *lines, "", options])


def _unknown_command(word: str, group: str) -> ConfigError:
    names = [name.removeprefix(group) for name in available_commands() if name.startswith(group)]
    nearest = get_close_matches(word, names, 2)
    suggestion = " or ".join(nearest) if nearest else f"one of {', '.join(names)}"
    return ConfigError(
        f"no command {word!r}", remedy=f"did you mean {suggestion}? --help lists them"
    )


def _declaration(command: Command, show_all: bool) -> type:
    """The settings of a command as tyro shows them: positional arguments, and options out of sight.

    Without ``show_all``, options that are neither common nor required are not in the help.
    """
    settings = command.load_settings()
    hints = get_type_hints(settings, include_extras=True)
    hides_options = bool(command.common) and not show_all

    changes: list[tuple[str, Any, Field[Any]]] = []
    for setting in fields(settings):
        name = setting.name
        default = _default(setting)
        if name in command.positional:
            shown_type = tyro.conf.Positional[hints[name]]
        elif hides_options and default and name not in command.common:
            shown_type = tyro.conf.Suppress[hints[name]]
        else:
            continue
        changes.append((name, shown_type, field(kw_only=setting.kw_only, **default)))

    documentation = settings.__doc__ or ""
    if command.common:
        documentation += f"\n\nAll options: {HELP_ALL}"
    return make_dataclass(
        settings.__name__,
        changes,
        bases=(settings,),
        frozen=True,
        namespace={"__doc__": documentation},
    )


def _default(setting: Field[Any]) -> Mapping[str, Any]:
    """Arguments of `dataclasses.field` for the default of a setting; empty if it is required."""
    if setting.default is not MISSING:
        return {"default": setting.default}
    if setting.default_factory is not MISSING:
        return {"default_factory": setting.default_factory}
    return {}


def _require_files(settings: Any) -> None:
    """Raise ConfigError if a required list of files is empty."""
    for setting in fields(settings):
        is_required = not _default(setting)
        if is_required and getattr(settings, setting.name) == ():
            raise ConfigError(f"no {setting.name} given", remedy="give at least one")
