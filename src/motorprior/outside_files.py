"""Files from outside, read within bounds: no folder, pipe or device in a file's place, and no more bytes than expected.

Opening a pipe waits for whoever writes to it, and a device may never end.
"""

from __future__ import annotations

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from motorprior.exceptions import ArtifactError, MotorPriorError

MAX_TOML, MAX_DOTS = 100_000, 8_000
"""Bytes, and dots among them: a key of n parts, ``a.a.a``, takes Python's reader time and memory that grow with n²."""


def require_file(path: Path, error: type[MotorPriorError] = ArtifactError) -> int:
    """The size [bytes] of a file.

    Raises:
        MotorPriorError: of the class ``error``: there is none, or it is a folder, a pipe, a socket or a device.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as reason:
        missing = isinstance(reason, FileNotFoundError | NotADirectoryError)
        problem = "no such file" if missing else f"cannot read ({getattr(reason, 'strerror', None) or reason})"
        raise error(problem, where=path, remedy="check the path") from reason
    if stat.S_ISDIR(found.st_mode):
        raise error("a folder, not a file", where=path, remedy="give a file")
    if not stat.S_ISREG(found.st_mode):
        remedy = "write what it gives into a file, and give that"
        raise error("a pipe, a socket or a device, not a file", where=path, remedy=remedy)
    return found.st_size


def read_bytes(path: Path, most: int, error: type[MotorPriorError] = ArtifactError) -> bytes:
    """All of a file.

    Raises:
        MotorPriorError: as `require_file`; it cannot be read, or is longer than ``most`` bytes.
    """
    if (size := require_file(path, error)) > most:
        problem = f"{size} bytes, more than the {most} that such a file may have"
        raise error(problem, where=path, remedy="split it, or give the file that was meant")
    try:
        with open(path, "rb") as file:
            return file.read(most)
    except OSError as reason:
        raise error(f"cannot read ({reason.strerror})", where=path, remedy="check the path") from reason


def read_text(path: Path, most: int, error: type[MotorPriorError] = ArtifactError) -> str:
    """All of a file of text in UTF-8, with or without a byte order mark.

    Raises:
        MotorPriorError: as `read_bytes`, or no such text.
    """
    try:
        return read_bytes(path, most, error).decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise error(f"not a text file ({reason})", where=path, remedy="save it as UTF-8") from reason


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """The table in a TOML file.

    Raises:
        ArtifactError: as `read_text`, longer than `MAX_TOML` or with more dots than `MAX_DOTS`, or not TOML.
    """
    text = read_text(path, MAX_TOML)
    if text.count(".") > MAX_DOTS:
        raise ArtifactError(f"more than {MAX_DOTS} dots", where=path, remedy=remedy)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy=remedy) from error
