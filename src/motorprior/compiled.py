"""``njit`` where numba is installed; on the robot's own computer the same functions run as plain Python.

A walking policy needs a few hundred multiplications per control step, so the one implementation of each formula
serves both: compiled inside a rollout of millions of steps, interpreted on a robot without numba. A parity test
ties the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numba import njit as njit
else:
    try:
        from numba import njit as njit
    except ModuleNotFoundError:  # the robot's computer

        def njit(**_options: Any) -> Callable[[Callable], Callable]:
            """Leave the function as it is."""
            return lambda function: function
