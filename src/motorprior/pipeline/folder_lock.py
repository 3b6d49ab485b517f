"""A folder has one writer at a time: a second command with the same ``--out`` is refused while the first runs.

The lock is the operating system's, on the file LOCK in the folder. It ends with the process that holds it, however that
ends, so no lock is ever stale; what HOLDER says about the process is for the message only. On NFS the lock holds
between machines where the server has a lock service (Linux since 2.6.12), and on one machine only where the mount says
``nolock`` or ``local_lock``. A file system without locks at all gets filelock's file in place of a lock, which names
its process: one of this machine that has died loses it, one of another machine keeps it until somebody removes LOCK.
"""

from __future__ import annotations

import os
import shlex
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError

LOCK, HOLDER = ".lock", ".running.json"
_LONGEST_COMMAND = 200
"""Characters of a command in a message."""


class _Mine(threading.local):
    """The folders that this thread has taken."""

    def __init__(self):
        self.folders: set[Path] = set()


_MINE = _Mine()
_OURS: set[Path] = set()
"""The folders that this process has taken, whichever thread it was."""


@contextmanager
def taken(folder: Path) -> Iterator[None]:
    """Be the only writer of a folder while this is open; what is taken already by the same thread stays so.

    The folder is made if there is none, and removed at the end if it was made here and nothing is in it.

    Raises:
        ArtifactError: another process or thread has it, another process has a folder that it is in, or it cannot be
            made or written.
    """
    place = folder.resolve()
    if place in _MINE.folders:
        yield
        return
    _require_free_parents(place)
    made = [part for part in (place, *place.parents) if not part.exists()]
    lock = FileLock(place / LOCK, timeout=0)
    _acquire(lock, folder)
    try:
        _MINE.folders.add(place)
        _OURS.add(place)
        write_json(place / HOLDER, _this_process())
        yield
    finally:
        _MINE.folders.discard(place)
        _OURS.discard(place)
        _release(lock, place, made)


def _require_free_parents(place: Path) -> None:
    """Refuse a folder inside of one where another process writes; a stage of a run, in its folder, is our own."""
    for parent in place.parents:
        if parent in _OURS:
            return
        if (parent / HOLDER).is_file():  # or the lock is another program's
            with suppress(OSError):  # a folder that we may not write to: nothing is known
                _locked(FileLock(parent / LOCK, timeout=0), parent).release()


def _acquire(lock: FileLock, folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _locked(lock, folder)
    except OSError as error:
        raise ArtifactError(
            f"cannot write there ({error.strerror or error})", where=folder, remedy="choose another folder"
        ) from error


def _locked(lock: FileLock, folder: Path) -> FileLock:
    try:
        lock.acquire()
    except Timeout:
        raise ArtifactError(
            f"another command writes there: {_holder(folder)}", where=folder,
            remedy="wait until it ends, or choose another folder",
        ) from None  # fmt: skip
    return lock


def _release(lock: FileLock, place: Path, made: list[Path]) -> None:
    """Leave nothing behind.

    The file goes while the lock is held: who has opened it by then finds, once it is theirs, that it has no name any
    more, and begins again.
    """
    with suppress(OSError):
        (place / HOLDER).unlink(missing_ok=True)
        (place / LOCK).unlink(missing_ok=True)
    lock.release()
    with suppress(OSError):  # something is in it
        for part in made:
            part.rmdir()


def _this_process() -> dict[str, str | int]:
    return {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "since": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": shlex.join(sys.argv)[:_LONGEST_COMMAND],
    }


def _holder(folder: Path) -> str:
    """The process that has the folder, in words; it may not have written them yet."""
    try:
        said = read_json(folder / HOLDER)
        words = f"process {said['pid']} on {said['host']}, since {said['since']}, {said['command']}"
    except (ArtifactError, KeyError, TypeError):
        return "a process that has just begun"
    return words[: 2 * _LONGEST_COMMAND]
