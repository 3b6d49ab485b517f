"""``njit`` with this library's own cache; where numba is not installed, the same functions run as plain Python.

A walking policy needs a few hundred multiplications per control step, so the one implementation of each formula
serves both: compiled inside a rollout of millions of steps, interpreted on a robot without numba. A parity test
ties the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from motorprior.kernel_cache import kernel_folder

if TYPE_CHECKING:
    from numba import njit as njit
else:
    try:
        import numba
    except ModuleNotFoundError:  # the robot's computer
        numba = None

    def njit(**options: Any) -> Callable[[Callable], Callable]:
        """`numba.njit` that caches in `kernel_folder`; leaves the function as it is where there is no numba.

        Numba takes the folder from a global setting when a function is decorated. It is set for that moment only, so
        that other people's functions, and a folder that the user chose, are left alone.
        """

        def decorate(function: Callable) -> Callable:
            if numba is None:
                return function
            chosen = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = chosen or kernel_folder()
            try:
                return numba.njit(**options)(function)
            finally:
                numba.config.CACHE_DIR = chosen

        return decorate
