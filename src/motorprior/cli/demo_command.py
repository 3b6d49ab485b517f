"""The command line that makes a page, from the settings beside it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from motorprior.cli.demo import Demo

_ALWAYS = ("fleet", "seed")
_NO_MATTER = ("out", "workers")
"""What the result does not depend on."""


def demo_command(settings: Mapping[str, Any]) -> str:
    """``motorprior demo`` with fleet, seed and every other option that is not the default.

    Args:
        settings: those of demo.json; keys that are no option are ignored. The folder of the logs is not named.
    """
    words = ["motorprior", "demo"]
    for field in fields(Demo):
        value = settings.get(field.name, field.default)
        if field.name in _NO_MATTER or (value == field.default and field.name not in _ALWAYS):
            continue
        words += [f"--{field.name.replace('_', '-')}", "FOLDER" if field.name == "logs" else str(value)]
    return shlex.join(words)
