"""Read a pickle that holds numbers in plain containers, and nothing else.

A pickle is a program. Its operations are read first and compared with an allow-list; it then runs with no
class or function of Python or numpy in reach: the handful of names numpy arrays need lead to the stand-ins
below, which check sizes and types before any memory is taken.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from motorprior.exceptions import LogError
from motorprior.logs.pickled_arrays import PickledArray, constructors
from motorprior.logs.pickled_tensors import PickledStorage, PickledTensor, storage_of, tensor_constructors

MAX_BYTES = 200_000_000
MAX_OPERATIONS = 5_000_000
MAX_DEPTH = 32
NOT_A_LOG = "use only log files from their original source; convert others to CSV where they were made"

_OPERATIONS = """
PROTO FRAME MARK STOP NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT
BINFLOAT STRING BINSTRING SHORT_BINSTRING BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE
BINUNICODE SHORT_BINUNICODE BINUNICODE8 EMPTY_LIST APPEND APPENDS LIST EMPTY_DICT DICT SETITEM
SETITEMS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 GET BINGET LONG_BINGET PUT BINPUT LONG_BINPUT
MEMOIZE GLOBAL STACK_GLOBAL REDUCE BUILD
"""
ALLOWED_OPERATIONS = frozenset(_OPERATIONS.split())
_PLAIN = (str, int, float, bool, type(None), bytes)


def load_plain(source: str | Path | bytes, *, where: str | Path | None = None) -> Any:
    """Unpickle dicts, lists, tuples, text, bytes and numbers; numeric numpy arrays become ``np.ndarray``.

    numpy scalars become Python numbers, bytearrays bytes. Text of Python 2 is read as latin1.

    Args:
        source: path of the file, or the pickle itself.
        where: file to name in errors; the path by default.

    Raises:
        LogError: unreadable, longer than 200 MB, truncated, or asking for any other class or function,
            which is named and not called.
    """
    where = where if where is not None or isinstance(source, bytes) else source
    return _load(source if isinstance(source, bytes) else _read_bounded(Path(source)), where, tensors=False)


def load_tensors(data: bytes, *, where: str | Path) -> Any:
    """The same of the pickle in a file of torch.save: its tensors become `PickledTensor`s, which hold no numbers.

    Raises:
        LogError: as `load_plain`.
    """
    return _load(data, where, tensors=True)


def _load(data: bytes, where: str | Path | None, tensors: bool) -> Any:
    if len(data) > MAX_BYTES:
        raise LogError(f"{len(data)} bytes, more than the {MAX_BYTES} a log may have", where=where, remedy=NOT_A_LOG)
    try:
        _check_operations(data, ALLOWED_OPERATIONS | {"BINPERSID"} if tensors else ALLOWED_OPERATIONS)
        loaded = _Unpickler(io.BytesIO(data), tensors).load()
        return _plain(loaded, 0, {})
    except LogError as error:
        raise LogError(error.problem, where=where, remedy=NOT_A_LOG) from error
    except Exception as error:
        raise LogError(
            f"not a complete pickle ({type(error).__name__}: {error})",
            where=where,
            remedy="copy the file again from its source",
        ) from error


class _Unpickler(pickle.Unpickler):
    """The one way Python offers to decide what a pickle may name is to override `find_class`."""

    def __init__(self, file: io.BytesIO, tensors: bool):
        super().__init__(file, encoding="latin1")
        self._constructors = {**constructors(MAX_BYTES), **(tensor_constructors() if tensors else {})}

    def find_class(self, module: str, name: str, /) -> Callable[..., Any]:
        constructor = self._constructors.get((module, name))
        if constructor is None:
            raise LogError(f"the pickle asks for {module}.{name}, which is refused")
        return constructor

    def persistent_load(self, pid: Any, /) -> PickledStorage:
        return storage_of(pid)


def _read_bounded(path: Path) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise LogError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def _check_operations(data: bytes, allowed: frozenset[str]) -> None:
    """Refuse operations outside the allow-list, memo indices that reserve memory, and trailing bytes."""
    stream, last = io.BytesIO(data), 0
    for count, (operation, argument, position) in enumerate(pickletools.genops(stream)):
        last = position or 0
        if operation.name not in allowed:
            detail = f" ({argument})" if isinstance(argument, str) else ""
            raise LogError(f"the pickle operation {operation.name}{detail} is refused")
        if operation.name.endswith("PUT") and not 0 <= int(str(argument)) <= count + 1:
            raise LogError(f"memo index {argument} after {count} operations is refused")
        if count >= MAX_OPERATIONS:
            raise LogError(f"more than {MAX_OPERATIONS} pickle operations are refused")
    if rest := data[last + 1 :].strip():
        raise LogError(f"{len(rest)} bytes follow the end of the pickle")


def _plain(value: Any, depth: int, done: dict[int, Any]) -> Any:
    """Copy containers with arrays for their stand-ins; shared parts stay shared, cycles are refused."""
    if type(value) in (*_PLAIN, PickledTensor):
        return value
    if type(value) is bytearray:
        return bytes(value)
    if depth >= MAX_DEPTH:
        raise LogError(f"containers nested deeper than {MAX_DEPTH} are refused")
    if type(value) not in (dict, list, tuple, PickledArray):
        raise LogError(f"the pickle holds {value!r}, which is neither a number, a text nor a container")
    if id(value) not in done:
        done[id(value)] = _plain_container(value, depth + 1, done)
    return done[id(value)]


def _plain_container(value: Any, depth: int, done: dict[int, Any]) -> Any:
    if isinstance(value, PickledArray):
        return value.array()
    if isinstance(value, dict):
        if bad := [key for key in value if type(key) not in _PLAIN]:
            raise LogError(f"the dictionary key {bad[0]!r} is neither a number nor a text")
        return {key: _plain(entry, depth, done) for key, entry in value.items()}
    return type(value)(_plain(entry, depth, done) for entry in value)
