"""Files of tensors (``.pt`` of torch.save), read without PyTorch and without running anything.

Such a file is a zip of a pickle and of raw numbers; of the pickle only names, types and shapes are taken.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown, spelled
from motorprior.logs.formats.parquet_pages import COPY_AGAIN
from motorprior.logs.formats.pickled_tensors import PickledTensor, require_inside
from motorprior.logs.formats.restricted_unpickler import load_tensors
from motorprior.logs.formats.table_columns import CORRECT, element_of, unreadable
from motorprior.outside_files import require_file

MAX_FILE = 50_000_000
"""Bytes; of such a file the list of contents alone may take a gigabyte."""
MAX_PICKLE = 1_000_000
MAX_NUMBERS = 30_000_000
"""Of the tensors that are asked for; several may share the bytes of the file."""
_NAMED = 8
"""Keys that an error names."""
_ZIP_ERRORS = (
    zipfile.BadZipFile, OSError, EOFError, KeyError, NotImplementedError, RuntimeError, ValueError, struct.error,
)  # fmt: skip


def tensor_columns(path: Path, names: list[str]) -> Iterator[dict[str, np.ndarray]]:
    """The named columns of a dictionary of tensors, in one batch: ``x`` is a tensor (T,), ``x[2]`` column 2 of (T, J).

    Raises:
        LogError: no complete file of tensors, one that asks for anything but tensors and numbers, a key that it lacks,
            or tensors of other shapes; names the key.
    """
    owners = {name: element_of(name) or (name, None) for name in names}
    tensors = read_tensors(path, {owner for owner, _ in owners.values()})
    yield {name: _column(tensors[owner], owner, index, path) for name, (owner, index) in owners.items()}


def read_tensors(path: Path, keys: set[str]) -> dict[str, np.ndarray]:
    """Arrays of some tensors (or numpy arrays) of a file by key, float64.

    Raises:
        LogError: as `tensor_columns`.
    """
    with _opened(path) as (archive, folder, content):
        if missing := sorted(keys - content.keys()):
            known = ", ".join(map(shown, list(content)[:_NAMED]))
            raise LogError(f"no tensor {missing[0]!r}; it has {known}", where=path, remedy=CORRECT)
        count = sum(prod(content[key].size) for key in keys if isinstance(content[key], PickledTensor))
        if count > MAX_NUMBERS:
            raise LogError(f"{count} numbers, more than {MAX_NUMBERS}", where=path, remedy="split the recording")
        order = _byte_order(archive, folder, path)
        return {key: _array(archive, folder, order, key, content[key], path) for key in sorted(keys)}


def contents_in_words(path: Path) -> str:
    """What a file of tensors has: keys, with the shapes of those that are tensors. No number of a tensor is read.

    Raises:
        LogError: as `tensor_columns`.
    """
    with _opened(path) as (_, _, content):
        return ", ".join(_entry(key, value) for key, value in list(content.items())[:_NAMED]) + (
            ", …" if len(content) > _NAMED else ""
        )


def _entry(key: Any, value: Any) -> str:
    size = value.size if isinstance(value, PickledTensor) else value.shape if isinstance(value, np.ndarray) else None
    return shown(key) if size is None else f"{shown(key)} of {spelled(tuple(size))}"


@contextmanager
def _opened(path: Path) -> Iterator[tuple[zipfile.ZipFile, str, dict[Any, Any]]]:
    """The archive, the folder in it, and the dictionary of its pickle."""
    if (size := require_file(path, LogError)) > MAX_FILE:
        raise LogError(f"{size} bytes, more than {MAX_FILE}", where=path, remedy="split the recording")
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive, *_pickle(archive, path)
    except _ZIP_ERRORS as error:
        raise unreadable(path, error) from error


def _pickle(archive: zipfile.ZipFile, path: Path) -> tuple[str, dict[Any, Any]]:
    """The folder in the archive, and the dictionary of its pickle."""
    found = [info for info in archive.infolist() if info.filename.split("/")[1:] == ["data.pkl"]]
    if len(found) != 1 or found[0].file_size > MAX_PICKLE:
        raise LogError("not a file of tensors of torch.save", where=path, remedy="save a dict of tensors")
    content = load_tensors(_stored(archive, found[0].filename, path), where=path)
    if not isinstance(content, dict):
        raise LogError(f"it holds a {type(content).__name__}", where=path, remedy="save a dict of tensors")
    return found[0].filename.removesuffix("data.pkl"), content


def _stored(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    """An entry that is no longer unpacked than the file itself."""
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > path.stat().st_size:
        raise LogError(f"{name[:60]!r} is packed", where=path, remedy="save it with torch.save")
    return archive.read(name)


def _byte_order(archive: zipfile.ZipFile, folder: str, path: Path) -> str:
    name = folder + "byteorder"
    return ">" if name in archive.namelist() and _stored(archive, name, path).strip() == b"big" else "<"


def _array(archive: zipfile.ZipFile, folder: str, order: str, key: str, value: Any, path: Path) -> np.ndarray:
    if isinstance(value, np.ndarray):
        return value.astype(np.float64)
    if not isinstance(value, PickledTensor):
        raise LogError(f"{key!r} is a {type(value).__name__}, not a tensor", where=path, remedy=CORRECT)
    raw = _stored(archive, f"{folder}data/{value.storage.key}", path)
    kind = np.dtype(order + value.storage.code)
    if len(raw) != value.storage.count * kind.itemsize:
        problem = f"{key!r}: {len(raw)} bytes for {value.storage.count} numbers of {kind}"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)
    require_inside(value)
    numbers = np.frombuffer(raw, dtype=kind)[value.offset :]
    steps = [kind.itemsize * step for step in value.stride]
    return np.lib.stride_tricks.as_strided(numbers, value.size, steps, writeable=False).astype(np.float64)


def _column(values: np.ndarray, key: str, index: int | None, path: Path) -> np.ndarray:
    if index is None and values.ndim == 2 and values.shape[1] == 1:
        index = 0
    if index is None and values.ndim == 1:
        return values
    if index is None or values.ndim != 2 or index >= values.shape[1]:
        shown = key if index is None else f"{key}[{index}]"
        raise LogError(f"{shown}: the tensor has shape {values.shape}", where=path, remedy=CORRECT)
    return values[:, index]
