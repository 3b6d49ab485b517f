"""Folders for files that another program or process reads meanwhile."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from motorprior.artifacts import is_gone, this_host

_NAME = re.compile(r"motorprior-(?P<host>[0-9a-f]{8})-(?P<pid>[0-9]{1,9})-\w+")


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A new folder of our own, removed at the end; those that killed processes of this user left are removed first."""
    for path in Path(tempfile.gettempdir()).glob("motorprior-*"):
        found = _NAME.fullmatch(path.name)
        with suppress(OSError):  # another user's, or just gone
            if found and found["host"] == this_host() and is_gone(int(found["pid"])) and _is_ours(path):
                shutil.rmtree(path)
    with tempfile.TemporaryDirectory(prefix=f"motorprior-{this_host()}-{os.getpid()}-") as folder:
        yield Path(folder)


def _is_ours(path: Path) -> bool:
    return path.lstat().st_uid == os.getuid()
