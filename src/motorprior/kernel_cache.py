"""One folder of compiled kernels per state of the source.

Numba's cache looks at the file of the kernel only: after a change in a function that the kernel calls, or an
upgrade, it would go on running the old machine code. A folder named after all sources cannot be stale.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from functools import cache
from pathlib import Path

KEPT = 4
"""Folders of other states that are kept."""


def source_digest(package: Path) -> str:
    """Digest of name, size and time of every Python file of the package."""
    parts = []
    for path in sorted(package.rglob("*.py")):
        status = path.stat()
        parts.append(f"{path.relative_to(package)}:{status.st_size}:{status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@cache
def kernel_folder() -> str:
    """This state's folder, made if it is not there; "" (numba's own choice) where no home can be written."""
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorprior" / "kernels"
        folder = root / source_digest(Path(__file__).parent)
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):  # no home
        return ""
    _drop_old(root, folder)
    return str(folder)


def _drop_old(root: Path, present: Path) -> None:
    """Remove the folders of all other states but the newest KEPT."""
    try:
        others = sorted((path for path in root.iterdir() if path != present), key=lambda path: path.stat().st_mtime)
    except OSError:  # another process removes old folders at the same time
        return
    for old in others[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
