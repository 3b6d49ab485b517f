"""Folders for files that another program or process reads meanwhile."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from motorprior.artifacts import is_gone, this_host

_NAME = re.compile(r"motorprior-(?P<where>[0-9a-f]{16})-(?P<pid>[0-9]{1,9})-\w+")


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder of our own, removed at the end; the first call removes what killed processes of this user left."""
    base = tempfile.gettempdir()
    _sweep(Path(base))
    with tempfile.TemporaryDirectory(prefix=f"motorprior-{_where()}-{os.getpid()}-", dir=base) as folder:
        yield Path(folder)


@lru_cache(maxsize=1)
def _sweep(base: Path) -> None:
    for path in base.glob("motorprior-*"):
        found = _NAME.fullmatch(path.name)
        with suppress(OSError):  # another user's, or just gone
            if found and found["where"] == _where() and is_gone(int(found["pid"])) and _is_ours(path):
                shutil.rmtree(path)


def _where() -> str:
    """This machine, and which of its containers numbers our processes."""
    numbers = Path("/proc/self/ns/pid")
    return this_host() + f"{zlib.crc32(os.readlink(numbers).encode() if numbers.is_symlink() else b''):08x}"


def _is_ours(path: Path) -> bool:
    return path.lstat().st_uid == os.getuid()
