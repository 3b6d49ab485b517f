"""``njit`` with this library's own cache folder; without numba, as on the robot, the functions run as plain Python."""

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
            # Numba reads this global setting when it decorates a function; the user's own functions
            # keep theirs.
            users = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = users or kernel_folder()
            try:
                return numba.njit(**options)(function)
            finally:
                numba.config.CACHE_DIR = users

        return decorate


def source_digest(package: Path) -> str:
    """Digest of names, sizes and modification times of the package's Python files."""
    files = [(path.relative_to(package), path.stat()) for path in sorted(package.rglob("*.py"))]
    text = "\n".join(f"{name}:{status.st_size}:{status.st_mtime_ns}" for name, status in files)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def kernel_folder() -> str:
    """Cache folder for the current sources; "" (numba's default) if the home folder is not writable.

    Numba checks only a kernel's own file: after a change in a function that it calls, it would
    reuse old machine code.
    """
    try:
        root = (
            Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
            / "motorprior"
            / "kernels"
        )
        folder = root / source_digest(Path(__file__).parent)
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):  # no home
        return ""
    with suppress(OSError):  # another process removes old folders at the same time
        for old in root.iterdir():
            # a younger one may belong to a running command
            if old.stat().st_mtime < time.time() - 7 * 24 * 3600:
                shutil.rmtree(old, ignore_errors=True)
    return str(folder)
