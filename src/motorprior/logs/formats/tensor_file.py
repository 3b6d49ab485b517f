"""Read files of tensors (``.pt`` of torch.save) without PyTorch.

Such a file is a zip of a pickle, with names, types and shapes, and of raw numbers.
"""

from __future__ import annotations

import collections
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, quoted
from motorprior.files import load_pickle, numpy_names, require_file
from motorprior.logs.formats.csv_table import COPY_AGAIN
from motorprior.logs.formats.table_columns import element_of, unreadable
from motorprior.logs.log_errors import CORRECT, missing_column

MAX_BYTES = 500_000_000
_TYPES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1", "BFloat16Storage": "bfloat16",
}  # fmt: skip


@dataclass(frozen=True)
class Tensor:
    """A view of the ``count`` numbers in the file ``data/KEY``; offset and strides count numbers."""

    code: str
    key: str
    count: int
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


def tensor_columns(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """Read columns of a dictionary of tensors: ``x`` is a tensor (T,), ``x[2]`` is column 2 of a tensor (T, J).

    Raises:
        LogError: not a complete file of tensors, a pickle with disallowed content, a missing key or a wrong shape.
    """
    owners = {name: element_of(name) for name in names}
    with _opened(path) as (archive, folder, content):
        if missing := sorted({owner for owner, _ in owners.values()} - content.keys()):
            raise missing_column("tensor", missing[0], content, path)
        tensors = {key: _array(archive, folder, key, content[key], path) for key, _ in owners.values()}
    return {name: _column(tensors[owner], owner, index, path) for name, (owner, index) in owners.items()}


def describe_tensors(path: Path) -> str:
    """Keys of a file of tensors, with shapes.

    Raises:
        LogError: as `tensor_columns`.
    """
    with _opened(path) as (_, _, content):
        shapes = {key: getattr(value, "size", None) for key, value in list(content.items())[:8]}
        entries = [
            f"{quoted(key)} {shape}" if isinstance(shape, tuple) else quoted(key) for key, shape in shapes.items()
        ]
        return ", ".join(entries) + (", …" if len(content) > 8 else "")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[zipfile.ZipFile, str, dict[Any, Any]]]:
    """The archive, the folder in it, and the dictionary of its pickle."""
    if require_file(path, LogError) > MAX_BYTES:
        raise LogError(f"more than {MAX_BYTES} bytes", where=path, remedy="split the recording")
    try:
        with zipfile.ZipFile(path) as archive:
            found = [name for name in archive.namelist() if name.split("/")[1:] == ["data.pkl"]]
            # torch.save does not compress, a zip bomb does
            if len(found) != 1 or any(each.compress_type != zipfile.ZIP_STORED for each in archive.infolist()):
                raise LogError("not a file of torch.save", where=path, remedy="save a dict of tensors")
            content = load_pickle(archive.read(found[0]), numpy_names() | _torch_names(), _storage)
            if not isinstance(content, dict):
                raise LogError(f"it holds a {type(content).__name__}", where=path, remedy="save a dict of tensors")
            yield archive, found[0].removesuffix("data.pkl"), content
    except LogError as error:
        raise error if error.where else LogError(error.problem, where=path, remedy=error.remedy) from error
    except Exception as error:  # damaged zip files raise many types
        raise unreadable(path, error) from error


def _torch_names() -> dict[tuple[str, str], Any]:
    def tensor(storage: tuple[str, str, int], offset: int, size: tuple, stride: tuple, *_: Any) -> Tensor:
        return Tensor(*storage, offset, tuple(size), tuple(stride))

    return {
        ("torch._utils", "_rebuild_tensor_v2"): tensor,
        ("collections", "OrderedDict"): collections.OrderedDict,
        **{("torch", name): code for name, code in _TYPES.items()},
    }


def _storage(reference: Any) -> tuple[str, str, int]:
    """Type, key and count of a persistent id ("storage", type, key, device, count)."""
    _, code, key, _, count = reference
    if code == "bfloat16":
        raise LogError("it holds numbers of type bfloat16", remedy="save them as float32, by tensor.float()")
    return code, key, count


def _array(archive: zipfile.ZipFile, folder: str, key: str, value: Any, path: Path) -> np.ndarray:
    if isinstance(value, np.ndarray):
        return np.array(value, np.float64)  # of the base class
    if not isinstance(value, Tensor):
        raise LogError(f"{key!r} is a {type(value).__name__}, not a tensor", where=path, remedy=CORRECT)
    name = folder + "byteorder"
    order = ">" if name in archive.namelist() and archive.read(name).strip() == b"big" else "<"
    kind = np.dtype(order + value.code)
    raw = archive.read(f"{folder}data/{value.key}")
    last = value.offset + sum((length - 1) * step for length, step in zip(value.size, value.stride, strict=True))
    # as_strided reads any memory, so the tensor must lie within its numbers
    negative = min((value.offset, *value.size, *value.stride)) < 0
    if negative or len(raw) != value.count * kind.itemsize or prod(value.size) > value.count or last >= value.count:
        problem = f"{key!r}: size {value.size}, stride {value.stride} do not fit {len(raw)} bytes"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)
    numbers = np.frombuffer(raw, dtype=kind)[value.offset :]
    steps = [kind.itemsize * step for step in value.stride]
    return np.lib.stride_tricks.as_strided(numbers, value.size, steps, writeable=False).astype(np.float64)


def _column(values: np.ndarray, key: str, index: int | None, path: Path) -> np.ndarray:
    if index is None and values.ndim == 2 and values.shape[1] == 1:
        index = 0
    if index is None and values.ndim == 1:
        return values
    if index is None or values.ndim != 2 or index >= values.shape[1]:
        name = key if index is None else f"{key}[{index}]"
        raise LogError(f"{name}: the tensor has shape {values.shape}", where=path, remedy=CORRECT)
    return values[:, index]
