"""A learning curve as events for TensorBoard, beside metrics.jsonl, which is always written."""

# pyright: reportMissingImports=false
# An extra.
from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from motorprior.exceptions import ConfigError
from motorprior.pipeline.stage import locked
from motorprior.pipeline.walking.walk_metrics import read_metrics

EVENTS = "tensorboard"
"""Folder of the events, in that of a walk."""
_NUMBERS = ("return_mean", "return_best", "upright", "speed_error")


def require_tensorboard() -> Any:
    """The library that writes events.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import tensorboardX
    except ImportError as error:
        raise ConfigError(
            "tensorboardX is not installed", remedy="pip install 'motorprior[tensorboard]'", argument="tensorboard"
        ) from error
    return tensorboardX


@contextmanager
def events(folder: Path) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """A function that adds a row of metrics.jsonl to the events in ``folder``, which are begun anew.

    Raises:
        ConfigError: see `require_tensorboard`.
    """
    library = require_tensorboard()
    shutil.rmtree(folder, ignore_errors=True)
    writer = library.SummaryWriter(str(folder))

    def add(row: Mapping[str, Any]) -> None:
        for name in _NUMBERS:
            writer.add_scalar(f"walk/{name}", row[name], row["iteration"])
        writer.flush()

    try:
        yield add
    finally:
        writer.close()


def write_events(folder: Path) -> None:
    """The learning curve of the finished training in ``folder``.

    Raises:
        ArtifactError: see `read_metrics`.
    """
    told = read_metrics(folder)
    with locked(folder), events(folder / EVENTS) as add:
        for place in range(len(told["iteration"])):
            add({name: values[place].item() for name, values in told.items()})
