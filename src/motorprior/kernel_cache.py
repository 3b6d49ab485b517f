"""One folder of compiled kernels per state of the source.

Numba's cache looks at the file of the kernel only: after a change in a function that the kernel calls, or an
upgrade, it would go on running the old machine code. A folder named after all sources cannot be stale.
"""

from __future__ import annotations

import hashlib
import os
import shutil
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


def choose_folder() -> None:
    """Point numba to this state's folder, unless NUMBA_CACHE_DIR is set or no home can be written."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motorprior" / "kernels"
        folder = root / source_digest(Path(__file__).parent)
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        others = sorted((path for path in root.iterdir() if path != folder), key=lambda path: path.stat().st_mtime)
        for old in others[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    except (OSError, RuntimeError):  # no home, or another process removes old folders at the same time
        return
