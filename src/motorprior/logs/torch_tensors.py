"""Files of tensors (``.pt`` of torch.save), zips of a pickle and raw numbers, read without PyTorch."""

from __future__ import annotations

import collections
import zipfile
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import require_size
from motorprior.exceptions import LogError
from motorprior.logs.pickles import load_pickle
from motorprior.logs.tables import unreadable

_TYPES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1", "BFloat16Storage": "bfloat16",
}  # fmt: skip
_SAVE = "save a dict of tensors by torch.save"


def torch_content(path: Path) -> dict[Any, Any]:
    """The dictionary of the file's pickle, with arrays for tensors; raises LogError for a damaged file."""
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


_NAMES: dict[tuple[str, str], Any] = {
    ("torch._utils", "_rebuild_tensor_v2"): _view,
    ("collections", "OrderedDict"): collections.OrderedDict,
    **{("torch", name): code for name, code in _TYPES.items()},
}
