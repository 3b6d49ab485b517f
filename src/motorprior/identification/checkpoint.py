"""Results of steps of a fit that an interrupted run has saved."""

from collections.abc import Callable
from itertools import count
from typing import TypeAlias

import numpy as np

Arrays: TypeAlias = dict[str, np.ndarray]
# (name of the step, compute) -> its saved arrays; `compute` gives them if they are not saved
Checkpoint: TypeAlias = Callable[[str, Callable[[], Arrays]], Arrays]
# the same for the parts of a step, which are numbered in the order of the calls
PartCheckpoint: TypeAlias = Callable[[Callable[[], Arrays]], Arrays]


def unsaved(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """A `Checkpoint` that saves nothing."""
    return compute()


def unsaved_part(compute: Callable[[], Arrays]) -> Arrays:
    """A `PartCheckpoint` that saves nothing."""
    return compute()


def parts_of(name: str, checkpoint: Checkpoint) -> PartCheckpoint:
    """Saves the parts of the step ``name``.

    A run that continues this one must ask for the same parts in the same order, as a deterministic
    search does.
    """
    numbers = count()
    return lambda compute: checkpoint(f"{name}_part_{next(numbers)}", compute)
