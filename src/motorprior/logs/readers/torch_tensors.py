"""Files of tensors (``.pt`` of torch.save), zips of a pickle and raw numbers, read by a column map without PyTorch."""

from __future__ import annotations

import collections
import zipfile
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import require_file, require_size
from motorprior.exceptions import LogError, quoted
from motorprior.logs.column_map import ColumnMap
from motorprior.logs.log_reader import LogReader
from motorprior.logs.pickles import load_pickle
from motorprior.logs.tables import element_of, unreadable
from motorprior.logs.validity import CORRECT, missing_column

_TYPES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1", "BFloat16Storage": "bfloat16",
}  # fmt: skip
_SAVE = "save a dict of tensors by torch.save"


def tensor_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """Columns of a dictionary of tensors: ``x`` is a tensor (T,), ``x[2]`` is column 2 of a tensor (T, J)."""
    content, found = _content(path), {}
    for name in names:
        key, index = element_of(name)
        if key not in content:
            raise missing_column("tensor", key, content, path)
        values = content[key]
        if not isinstance(values, np.ndarray) or values.ndim not in (1, 2):
            raise LogError(f"{key!r} is not a tensor of 1 or 2 dimensions", where=path, remedy=CORRECT)
        table = values[:, None] if values.ndim == 1 else values
        if (index or 0) >= table.shape[1] or (index is None and table.shape[1] > 1):
            raise LogError(f"{name}: the tensor has shape {values.shape}", where=path, remedy=CORRECT)
        found[name] = table[:, index or 0].astype(np.float64)
    return found


def _unmapped(path: Path) -> str:
    shapes = {key: getattr(value, "shape", "") for key, value in _content(path).items()}
    return f"unmapped tensors: {', '.join(f'{quoted(key)} {shape}' for key, shape in list(shapes.items())[:8])}"


def _content(path: Path) -> dict[Any, Any]:
    """The dictionary of the file's pickle, with arrays for tensors."""
    require_file(path, LogError)
    try:
        with zipfile.ZipFile(path) as archive:
            files = archive.namelist()
            require_size(sum(each.file_size for each in archive.infolist()), path, LogError)
            found = [name for name in files if name.split("/")[1:] == ["data.pkl"]]
            if len(found) != 1:
                raise LogError("not a file of torch.save", where=path, remedy=_SAVE)
            folder = found[0].removesuffix("data.pkl")
            marked = f"{folder}byteorder" in files and archive.read(f"{folder}byteorder").strip()
            order = ">" if marked == b"big" else "<"

            def storage(reference: Any) -> np.ndarray:
                """The numbers of a persistent id ("storage", type, key, device, count)."""
                if reference[1] == "bfloat16":
                    problem = "it holds numbers of type bfloat16"
                    raise LogError(problem, remedy="save them as float32, by tensor.float()")
                return np.frombuffer(archive.read(f"{folder}data/{reference[2]}"), dtype=order + reference[1])

            content = load_pickle(archive.read(found[0]), _NAMES, storage, path)
    except LogError:
        raise
    except Exception as error:  # damaged zip files raise many types
        raise unreadable(path, error) from error
    if not isinstance(content, dict):
        raise LogError(f"it holds a {type(content).__name__}", where=path, remedy=_SAVE)
    return content


def _view(numbers: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> np.ndarray:
    """A tensor; offset and stride count numbers. as_strided reads any memory, so it must lie within its numbers."""
    last = offset + sum((length - 1) * step for length, step in zip(size, stride, strict=True))
    if min((offset, *size, *stride)) < 0 or prod(size) > len(numbers) or last >= len(numbers):
        raise LogError(f"a tensor of size {size}, stride {stride} does not fit {numbers.nbytes} bytes", remedy=_SAVE)
    steps = [numbers.itemsize * step for step in stride]
    return np.lib.stride_tricks.as_strided(numbers[offset:], size, steps, writeable=False)


READER = LogReader("tensors", (".pt",), columns=tensor_columns, unmapped=_unmapped)
_NAMES: dict[tuple[str, str], Any] = {
    ("torch._utils", "_rebuild_tensor_v2"): _view,
    ("collections", "OrderedDict"): collections.OrderedDict,
    **{("torch", name): code for name, code in _TYPES.items()},
}
