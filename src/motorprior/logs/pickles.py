"""Restricted unpickler for third-party files, also of torch.save: executes no code.

It reads plain containers, arrays and numbers. `pickled_arrays` runs it with limits.
"""

import collections
import io
import math
import pickle
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorprior.artifacts import require_size
from motorprior.exceptions import LogError

_COPY = "copy it again from its original source; convert others to CSV where they were made"
_SAVE = "save a dict of tensors by torch.save"


class _NumberType:
    """A dtype of plain numbers from its code, such as f8; its state only sets the byte order."""

    def __init__(self, code: str, *_: Any):
        if not re.fullmatch("[biuf][1248]", code):
            raise LogError(f"the pickle holds values of type {code[:20]!r}, not plain numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple) -> None:
        self.dtype = self.dtype.newbyteorder(">" if state[1] == ">" else "<")


class _NumberArray(np.ndarray):
    """An array of plain numbers; raw bytes of an object array would be used as addresses."""

    def __setstate__(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, state: tuple
    ) -> None:
        version, shape, number_type, *rest = state
        super().__setstate__((version, shape, number_type.dtype, *rest))


def _scalar(number_type: _NumberType, raw: bytes | str) -> Any:
    data = raw.encode("latin1") if isinstance(raw, str) else raw
    return np.frombuffer(data, number_type.dtype)[0]


def _array(
    raw: bytes, number_type: _NumberType, shape: tuple[int, ...], order: Literal["C", "F"]
) -> np.ndarray:
    return np.frombuffer(raw, number_type.dtype).reshape(shape, order=order)


def _view(
    numbers: np.ndarray, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> np.ndarray:
    """A tensor; offset and stride count numbers. NumPy raises unless it lies within these."""
    count = math.prod(size)
    if count > numbers.size:
        raise LogError(
            f"the pickle holds a tensor of {count} numbers in a storage of {numbers.size}"
        )
    data = np.ravel(numbers).tobytes()
    strides = [numbers.itemsize * step for step in stride]
    return np.ndarray(size, numbers.dtype, data, numbers.itemsize * offset, strides)


_STORAGES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8",
    "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "b1",
}  # fmt: skip
# (module, name) -> substitute; arrays and scalars of plain numbers by all versions of numpy and
# Python, and tensors
_ALLOWED: dict[tuple[str, str], Any] = {
    ("_codecs", "encode"): lambda text, _: text.encode("latin1"),  # bytes in pickles of protocol 2
    # empty bytes; others are literals
    ("builtins", "bytes"): lambda: b"",
    ("__builtin__", "bytes"): lambda: b"",
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): _NumberType,
    ("torch._utils", "_rebuild_tensor_v2"): _view,
    ("collections", "OrderedDict"): collections.OrderedDict,
    **{("torch", name): code for name, code in _STORAGES.items()},
}
for _core in ("numpy.core", "numpy._core"):
    _ALLOWED[f"{_core}.multiarray", "_reconstruct"] = lambda *_: _NumberArray(0)
    _ALLOWED[f"{_core}.multiarray", "scalar"] = _scalar
    _ALLOWED[f"{_core}.numeric", "_frombuffer"] = _array


def load_pickle(data: bytes, persistent: Callable[[Any], Any] = lambda pid: pid) -> Any:
    """Unpickle plain containers, arrays and scalars of numpy, and tensors.

    Text of Python 2 is latin1. ``persistent`` resolves persistent ids.

    Raises:
        LogError: a name that is not allowed, or a damaged pickle.
        MemoryError: the process has a limit, and the pickle needs more.
    """

    class Restricted(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            if (module, name) not in _ALLOWED:
                raise LogError(
                    f"the pickle imports {module[:80]}.{name[:80]}, which is not allowed"
                )
            return _ALLOWED[module, name]

        def persistent_load(self, pid: Any) -> Any:
            return persistent(pid)

    try:
        return Restricted(io.BytesIO(data), encoding="latin1").load()
    except MemoryError:
        raise
    except LogError as error:
        raise LogError(error.problem, remedy=error.remedy or _COPY) from error
    except Exception as error:  # a damaged pickle can raise any exception
        problem = f"not a complete pickle ({type(error).__name__}: {error})"
        raise LogError(problem, remedy=_COPY) from error


def require_archive_size(archive: zipfile.ZipFile, path: Path) -> None:
    """Raise LogError if the unpacked members exceed `artifacts.MAX_BYTES`.

    zipfile reads no more than they state.
    """
    require_size(sum(member.file_size for member in archive.infolist()), path, LogError)


def torch_content(path: Path) -> dict[Any, Any]:
    """The dictionary in a file of torch.save, with arrays for tensors.

    A damaged archive raises many types of errors.
    """
    with zipfile.ZipFile(path) as archive:
        require_archive_size(archive, path)
        pickles = [name for name in archive.namelist() if name.split("/")[1:] == ["data.pkl"]]
        if len(pickles) != 1:
            raise LogError("not a file of torch.save", where=path, remedy=_SAVE)
        folder = pickles[0].removesuffix("data.pkl")

        def storage(persistent_id: Any) -> np.ndarray:
            """The numbers of a persistent id ("storage", type, key, device, count)."""
            data = archive.read(f"{folder}data/{persistent_id[2]}")
            return np.frombuffer(data, dtype=persistent_id[1])

        content = load_pickle(archive.read(pickles[0]), storage)
    if not isinstance(content, dict):
        raise LogError(f"it holds a {type(content).__name__}", where=path, remedy=_SAVE)
    return content
