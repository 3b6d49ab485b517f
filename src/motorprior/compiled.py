"""Compiled kernels: ``njit`` with this library's own cache folder.

Importing a kernel writes nothing: its cache is opened when the kernel is first compiled. Without
numba, as on the robot's computer, the functions run as plain Python.
"""

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

MAX_AGE = 7 * 24 * 3600.0  # of an unused cache folder [s]; a younger one may be in use

if TYPE_CHECKING:
    import numba
    from numba import njit as njit
else:
    try:
        import numba
    except ModuleNotFoundError:  # the robot's computer
        numba = None

    def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable], Callable]:
        """`numba.njit` with its cache in `kernel_folder`; without numba, the function itself."""

        def decorate(function: Callable) -> Callable:
            if numba is None:
                return function

            kernel = numba.njit(**options)(function)
            if cache and not numba.config.DISABLE_JIT:
                kernel._cache = _KernelCache(function)
            return kernel

        return decorate


class _KernelCache:
    """Numba's cache of a function, opened at its first use."""

    def __init__(self, function: Callable):
        self._function = function
        self._file = Path(function.__code__.co_filename)
        self._stamp = _stamp(self._file)
        loaded_sources()

    @cached_property
    def _opened(self) -> Any:
        from numba.core.caching import FunctionCache, NullCache

        if _stamp(self._file) != self._stamp:  # the file was edited after its import
            return NullCache()
        # Numba reads this global setting when it opens a cache; the user's own functions keep
        # theirs.
        config: Any = numba.config  # pyright: ignore[reportPrivateImportUsage]
        users_folder = config.CACHE_DIR
        config.CACHE_DIR = users_folder or kernel_folder()
        try:
            return FunctionCache(self._function)
        finally:
            config.CACHE_DIR = users_folder

    def __getattr__(self, name: str) -> Any:
        return getattr(self._opened, name)


def _stamp(file: Path) -> tuple[int, int]:
    try:
        status = file.stat()
    except OSError:  # a function without a file
        return 0, 0
    return status.st_mtime_ns, status.st_size


@cache
def loaded_sources() -> str:
    """`source_digest` of this package when its first kernel was imported."""
    return source_digest(Path(__file__).parent)


def source_digest(package: Path) -> str:
    """Digest of names, sizes and modification times of the package's Python files."""
    lines = []
    for path in sorted(package.rglob("*.py")):
        status = path.stat()
        lines.append(f"{path.relative_to(package)}:{status.st_size}:{status.st_mtime_ns}")
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


@cache
def kernel_folder() -> str:
    """Make the cache folder of the current sources, and remove old ones.

    Numba checks only a kernel's own file: after a change in a function that the kernel calls, it
    would reuse old machine code. Without a writable home folder the result is "", numba's default.
    """
    try:
        user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        root = user_cache / "motorprior" / "kernels"
        folder = root / loaded_sources()
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):  # RuntimeError: the user has no home folder
        return ""

    with suppress(OSError):  # another process removes old folders at the same time
        for old in root.iterdir():
            if old.stat().st_mtime < time.time() - MAX_AGE:
                shutil.rmtree(old, ignore_errors=True)
    return str(folder)
