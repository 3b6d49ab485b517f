"""Results of steps of a fit that an interrupted run has saved."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

Arrays: TypeAlias = dict[str, np.ndarray]
# (name of the step, compute) -> its saved arrays; `compute` gives them if they are not saved
Checkpoint: TypeAlias = Callable[[str, Callable[[], Arrays]], Arrays]


def unsaved(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """A `Checkpoint` that saves nothing."""
    return compute()
