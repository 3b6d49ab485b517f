"""Third-party files: bounded sizes, one clear error, and an allow-list for pickles."""

from __future__ import annotations

import codecs
import gzip
import io
import pickle
import re
import tomllib
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorprior.exceptions import ArtifactError, LogError, MotorPriorError

MAX_FILE = 2_000_000_000  # bytes
MAX_UNPACKED = 500_000_000  # bytes of an unpacked gzip file or pickle


def require_file(path: Path, error: type[MotorPriorError] = ArtifactError) -> int:
    """Size [bytes] of a regular file.

    Raises:
        MotorPriorError: of class ``error``: missing, or a folder, pipe or device.
    """
    if not path.exists():
        raise error("no such file", where=path, remedy="check the path")
    if not path.is_file():
        raise error("not a file", where=path, remedy="give a file")
    return path.stat().st_size


def read_bytes(path: Path, max_bytes: int = MAX_FILE, error: type[MotorPriorError] = ArtifactError) -> bytes:
    """Content of a file, unpacked if its name ends in ``.gz``.

    Raises:
        MotorPriorError: as `require_file`; unreadable, damaged, or larger than ``max_bytes`` (`MAX_UNPACKED` unpacked).
    """
    size, limit = require_file(path, error), max_bytes
    try:
        if path.suffix == ".gz":
            limit = min(max_bytes, MAX_UNPACKED)
            with gzip.open(path, "rb") as file:
                data = file.read(limit + 1)
            size = len(data)
        else:
            data = path.read_bytes() if size <= limit else b""
    except (OSError, EOFError, zlib.error) as reason:
        raise error(f"unreadable or damaged ({reason})", where=path, remedy="copy it again from its source") from reason
    if size > limit:
        raise error(f"more than {limit} bytes", where=path, remedy="split it, or check that it is the right file")
    return data


def read_text(path: Path, max_bytes: int, error: type[MotorPriorError] = ArtifactError) -> str:
    """Text of a UTF-8 file, with or without byte order mark.

    Raises:
        MotorPriorError: as `read_bytes`, or not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes, error).decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        raise error(f"not a text file ({reason})", where=path, remedy="save it as UTF-8") from reason


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Table of a TOML file.

    Raises:
        ArtifactError: as `read_text`, or not TOML.
    """
    try:
        return tomllib.loads(read_text(path, 100_000))
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy=remedy) from error


class _NumberType:
    """A dtype of plain numbers from its code, such as f8; its state can only change the byte order."""

    def __init__(self, code: str, *_: Any):
        if not re.fullmatch("[biuf][1248]", code):
            raise LogError(f"the pickle holds values of type {code[:20]!r}, not plain numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple) -> None:
        self.dtype = self.dtype.newbyteorder(">" if state[1] == ">" else "<")


class _NumberArray(np.ndarray):
    """An array of plain numbers; raw bytes of an object array would be used as addresses."""

    def __setstate__(self, state: tuple) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        version, shape, kind, *rest = state
        super().__setstate__((version, shape, kind.dtype, *rest))


def _scalar(kind: _NumberType, raw: bytes | str) -> Any:
    return np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, kind.dtype)[0]


def _array(raw: bytes, kind: _NumberType, shape: tuple[int, ...], order: Literal["C", "F"]) -> np.ndarray:
    return np.frombuffer(raw, kind.dtype).reshape(shape, order=order)


def numpy_names() -> dict[tuple[str, str], Any]:
    """Allow-list for pickles of numpy arrays and scalars of plain numbers, from all versions of numpy and Python."""
    names: dict[tuple[str, str], Any] = {
        ("_codecs", "encode"): codecs.encode,
        **dict.fromkeys((("builtins", "bytes"), ("__builtin__", "bytes")), bytes),
        ("numpy", "ndarray"): "ndarray",
        ("numpy", "dtype"): _NumberType,
    }
    for core in ("numpy.core", "numpy._core"):
        names[f"{core}.multiarray", "_reconstruct"] = lambda *_: _NumberArray(0)
        names[f"{core}.multiarray", "scalar"] = _scalar
        names[f"{core}.numeric", "_frombuffer"] = _array
    return names


def load_pickle(
    data: bytes, allowed: Mapping[tuple[str, str], Any], persistent: Callable[[Any], Any] | None = None
) -> Any:
    """Unpickle plain containers and the names in ``allowed``; text of Python 2 is latin1.

    Args:
        data: the pickle.
        allowed: (module, name) -> substitute; no other name is imported.
        persistent: resolves a persistent id.

    Raises:
        LogError: a name that is not allowed, or a damaged pickle.
    """

    class Restricted(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            if (module, name) not in allowed:
                raise LogError(f"the pickle imports {module[:80]}.{name[:80]}, which is not allowed")
            return allowed[module, name]

        def persistent_load(self, pid: Any) -> Any:
            if persistent is None:
                raise LogError("the pickle refers to external data")
            return persistent(pid)

    remedy = "copy it again from its original source; convert others to CSV where they were made"
    try:
        return Restricted(io.BytesIO(data), encoding="latin1").load()
    except LogError as error:
        raise LogError(error.problem, remedy=error.remedy or remedy) from error
    except Exception as error:  # a damaged pickle can raise any exception
        raise LogError(f"not a complete pickle ({type(error).__name__}: {error})", remedy=remedy) from error
