"""The options of a command: its settings as tyro declares and parses them."""

from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, make_dataclass
from inspect import getdoc
from typing import Any, get_type_hints

import tyro

from motorprior.cli.command_table import Command
from motorprior.cli.unknown_options import unknown_word
from motorprior.exceptions import ConfigError

HELP = ("-h", "--help")
HELP_ALL = "--help-all"


def parse_options(command: Command, name: str, words: list[str]) -> Any:
    """Settings of the command ``name`` from the words that follow it.

    Raises ConfigError for an unknown option or an empty list of files, and SystemExit after help
    (code 0) or a wrong value (code 2).
    """
    shows_all = HELP_ALL in words or not set(HELP) & set(words)
    declaration = _declaration(command, shows_all)
    tyro_words = ["--help" if word == HELP_ALL else word for word in words]
    settings, unknown = tyro.cli(
        declaration, prog=f"motorprior {name}", args=tyro_words, return_unknown_args=True
    )
    if unknown:
        raise unknown_word(command, words, unknown[0])
    _require_files(settings)
    return settings


def _declaration(command: Command, shows_all: bool) -> type:
    """The settings of a command, with its positional arguments and the options out of sight.

    Unless ``shows_all``, options that are neither common nor required are not in the help.
    """
    settings = command.load_settings()
    hints = get_type_hints(settings, include_extras=True)
    hides_options = bool(command.common) and not shows_all

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

    # the summary is the command's line in the table, so that both always agree
    _, _, details = (getdoc(settings) or "").partition("\n\n")
    paragraphs = [command.help, details]
    if command.common:
        paragraphs.append(f"All options: {HELP_ALL}")
    documentation = "\n\n".join(filter(None, paragraphs))
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
