"""Read a pickle that holds numbers in plain containers, and nothing else.

A pickle is a program. No class or function of Python or numpy is in its reach: the handful of names numpy arrays need
lead to stand-ins, which check sizes and types before any memory is taken (`PickleMachine`).
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from motorprior.exceptions import LogError, shown
from motorprior.logs.formats.pickle_machine import PickleMachine
from motorprior.logs.formats.pickled_arrays import Constructor, PickledArray, constructors
from motorprior.logs.formats.pickled_tensors import PickledTensor, storage_of, tensor_constructors
from motorprior.outside_files import read_bytes

MAX_BYTES = 100_000_000
MAX_DEPTH = 32
NOT_A_LOG = "use only log files from their original source; convert others to CSV where they were made"
_PLAIN = (str, int, float, bool, type(None), bytes)


def load_plain(source: str | Path | bytes, *, keys: Collection[str] | None = None) -> Any:
    """Unpickle dicts with texts as keys, lists, tuples, text, bytes and numbers; numeric arrays become ``np.ndarray``.

    numpy scalars become Python numbers, bytearrays bytes. Text of Python 2 is read as latin1.

    Args:
        source: path of the file, or the pickle itself.
        keys: what is wanted of a dict; the rest of it is left out. All of whatever it is if not given.

    Raises:
        LogError: unreadable, longer than 100 MB, truncated, no dict with these keys, or asking for any other class or
            function, which is named and not called.
    """
    if isinstance(source, bytes):
        return _load(source, None, PickleMachine(constructors(MAX_BYTES)), keys)
    data = read_bytes(Path(source), MAX_BYTES, LogError)
    return _load(data, source, PickleMachine(constructors(MAX_BYTES)), keys)


def load_tensors(data: bytes, *, where: str | Path) -> Any:
    """The same of the pickle in a file of torch.save: its tensors become `PickledTensor`s, which hold no numbers.

    Raises:
        LogError: as `load_plain`.
    """
    names = {**constructors(MAX_BYTES), **tensor_constructors()}
    return _load(data, where, PickleMachine(names, storage_of))


def _load(data: bytes, where: str | Path | None, machine: PickleMachine, keys: Collection[str] | None = None) -> Any:
    try:
        found = machine.run(data)
        return _plain(found if keys is None else _wanted(found, keys), 0, {})
    except LogError as error:
        raise LogError(error.problem, where=where, remedy=error.remedy or NOT_A_LOG) from error
    except Exception as error:
        raise LogError(
            f"not a complete pickle ({type(error).__name__}: {error})",
            where=where,
            remedy="copy the file again from its source",
        ) from error


def _wanted(found: Any, keys: Collection[str]) -> dict[str, Any]:
    """What a dict says of these keys."""
    if type(found) is not dict or not set(keys) <= found.keys():
        known = ", ".join(map(shown, list(found)[:8])) if type(found) is dict else type(found).__name__
        raise LogError(f"expected a dict of {list(keys)}, found {known}")
    return {key: found[key] for key in keys}


def _plain(value: Any, depth: int, done: dict[int, Any]) -> Any:
    """Copy containers with arrays for their stand-ins; shared parts stay shared, cycles are refused."""
    if type(value) in (*_PLAIN, PickledTensor):
        return value
    if depth >= MAX_DEPTH:
        raise LogError(f"containers nested deeper than {MAX_DEPTH} are refused")
    if type(value) not in (dict, list, tuple, PickledArray):
        what = value if isinstance(value, Constructor) else shown(value)
        raise LogError(f"the pickle holds {what}, which is neither a number, a text nor a container")
    if id(value) not in done:
        done[id(value)] = _plain_container(value, depth + 1, done)
    return done[id(value)]


def _plain_container(value: Any, depth: int, done: dict[int, Any]) -> Any:
    if isinstance(value, PickledArray):
        return value.array()
    if isinstance(value, dict):
        return {key: _plain(entry, depth, done) for key, entry in value.items()}
    return type(value)(_plain(entry, depth, done) for entry in value)
