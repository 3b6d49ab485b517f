"""``motorprior identify``: fit a motor prior to motor logs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.commands.identify import Identify


@dataclass(frozen=True)
class IdentifyCommand(Identify):
    """Learn a motor prior from the log of a bench, or from logs of a suspended robot."""

    bench: tyro.conf.Positional[tuple[Path, ...]]
