"""``njit`` with this library's own cache folder; without numba, as on the robot, the functions run as plain Python."""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numba import njit as njit
else:
    try:
        import numba
    except ModuleNotFoundError:  # the robot's computer
        numba = None

    def njit(**options: Any) -> Callable[[Callable], Callable]:
        """`numba.njit` that caches in `kernel_folder`; returns the function unchanged where numba is missing."""

        def decorate(function: Callable) -> Callable:
            if numba is None:
                return function
            # Numba reads this global setting when it decorates a function; the user's own functions keep theirs.
            users = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = users or kernel_folder()
            try:
                return numba.njit(**options)(function)
            finally:
                numba.config.CACHE_DIR = users

        return decorate


def source_digest(package: Path) -> str:
    """Digest of names, sizes and modification times of the package's Python files."""
    parts = []
    for path in sorted(package.rglob("*.py")):
        status = path.stat()
        parts.append(f"{path.relative_to(package)}:{status.st_size}:{status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@cache
def kernel_folder() -> str:
    """Cache folder for the present sources; "" (numba's default) if the home folder is not writable.

    Numba checks only a kernel's own file: after a change in a function that it calls, it would reuse old machine code.
    """
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorprior" / "kernels"
        folder = root / source_digest(Path(__file__).parent)
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):  # no home
        return ""
    with suppress(OSError):  # another process removes old folders at the same time
        unused = time.time() - 7 * 24 * 3600  # younger ones may belong to a command that still compiles
        for old in (path for path in root.iterdir() if path.stat().st_mtime < unused):
            shutil.rmtree(old, ignore_errors=True)
    return str(folder)
