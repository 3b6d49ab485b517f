"""Pickles of third parties: plain containers and numbers come through, no code runs."""

from __future__ import annotations

import codecs
import io
import pickle
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorprior.exceptions import LogError


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


_NUMPY: dict[tuple[str, str], Any] = {  # arrays and scalars of plain numbers, by all versions of numpy and Python
    ("_codecs", "encode"): codecs.encode,
    **dict.fromkeys((("builtins", "bytes"), ("__builtin__", "bytes")), bytes),
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): _NumberType,
}
for _core in ("numpy.core", "numpy._core"):
    _NUMPY[f"{_core}.multiarray", "_reconstruct"] = lambda *_: _NumberArray(0)
    _NUMPY[f"{_core}.multiarray", "scalar"] = _scalar
    _NUMPY[f"{_core}.numeric", "_frombuffer"] = _array


def load_pickle(
    data: bytes,
    allowed: Mapping[tuple[str, str], Any] | None = None,
    persistent: Callable[[Any], Any] | None = None,
    where: Path | None = None,
) -> Any:
    """Unpickle plain containers, arrays and scalars of numpy, and ``allowed`` names, (module, name) -> substitute.

    Text of Python 2 is latin1; ``persistent`` resolves persistent ids.

    Raises:
        LogError: a name that is not allowed, or a damaged pickle; names the file ``where``.
    """
    known = _NUMPY | dict(allowed or {})

    class Restricted(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            if (module, name) not in known:
                raise LogError(f"the pickle imports {module[:80]}.{name[:80]}, which is not allowed")
            return known[module, name]

        def persistent_load(self, pid: Any) -> Any:
            if persistent is None:
                raise LogError("the pickle refers to external data")
            return persistent(pid)

    remedy = "copy it again from its original source; convert others to CSV where they were made"
    try:
        return Restricted(io.BytesIO(data), encoding="latin1").load()
    except LogError as error:
        raise LogError(error.problem, where=where, remedy=error.remedy or remedy) from error
    except Exception as error:  # a damaged pickle can raise any exception
        problem = f"not a complete pickle ({type(error).__name__}: {error})"
        raise LogError(problem, where=where, remedy=remedy) from error
