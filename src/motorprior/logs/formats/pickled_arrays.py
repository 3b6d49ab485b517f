"""Stand-ins for the numpy names that appear in pickles, so that no numpy code runs on unchecked state."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown

_NUMERIC = re.compile(r"(b1|[iu][1248]|f[248])")
_MAX_DIMENSIONS = 8
_LARGEST = 2**40
"""Of a size: the product of longer numbers could take hours."""


class Constructor:
    """A name a pickle may call. It carries no state that a pickle could change."""

    __slots__ = ("_build", "_name")

    def __init__(self, name: str, build: Callable[..., Any]):
        self._name, self._build = name, build

    def __call__(self, *arguments: Any) -> Any:
        """Build what the pickle asks for, or refuse its arguments."""
        try:
            return self._build(*arguments)
        except TypeError as error:
            raise LogError(f"{self._name} is called in an unknown way ({error})") from error

    def __repr__(self) -> str:
        return self._name

    def __setstate__(self, state: Any) -> None:
        raise LogError(f"the pickle tries to change {self._name}, which is refused")


class Budget:
    """Bytes that one pickle may unfold to; a short pickle can name the same long text many times."""

    __slots__ = ("_left", "_limit")

    def __init__(self, limit: int):
        self._left = self._limit = limit

    def spend(self, count: int) -> None:
        """Take ``count`` bytes, or refuse."""
        self._left -= count
        if self._left < 0:
            raise LogError(f"the pickle unfolds to more than {self._limit} bytes")


class PickledDtype:
    """A numeric dtype: b1, i1..i8, u1..u8, f2..f8; objects, texts and records are refused."""

    __slots__ = ("_byte_order", "_code")

    def __init__(self, code: Any = None, align: Any = False, copy: Any = False):
        del align, copy
        if not isinstance(code, str) or not _NUMERIC.fullmatch(code):
            raise LogError(f"a numpy array of type {shown(code)} is refused, only numbers are read")
        self._code, self._byte_order = code, "="

    def __setstate__(self, state: Any) -> None:
        plain = isinstance(state, tuple) and len(state) in (8, 9) and state[2:5] == (None, None, None)
        if not plain or state[1] not in ("<", ">", "|", "="):
            raise LogError(f"the numpy dtype state {shown(state)} is refused")
        self._byte_order = state[1]

    def dtype(self) -> np.dtype[Any]:
        """The numpy dtype it stands for."""
        return np.dtype(self._byte_order + self._code)


class PickledArray:
    """An array whose bytes are compared with its shape before anything is made of them."""

    __slots__ = ("_array", "_budget")

    def __init__(self, budget: Budget, array: np.ndarray | None = None):
        self._budget, self._array = budget, array

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            raise LogError("a numpy array with an unknown kind of state is refused")
        _, shape, dtype, fortran, raw = state
        self._array = _decode(self._budget, raw, dtype, shape, "F" if fortran else "C")

    def array(self) -> np.ndarray:
        """A writable copy in native byte order."""
        if self._array is None:
            raise LogError("the pickle holds a numpy array without content")
        return self._array.astype(self._array.dtype.newbyteorder("="))


def constructors(max_bytes: int) -> Mapping[tuple[str, str], Constructor]:
    """Everything a pickle may name, for one load.

    Args:
        max_bytes: bytes that its texts and arrays may unfold to, in total.
    """
    budget = Budget(max_bytes)

    def encode(text: Any, encoding: Any = "utf-8") -> bytes:
        if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
            raise LogError(f"encoding {type(text).__name__} as {shown(encoding)} is refused")
        budget.spend(len(text))
        return text.encode("latin1")

    def reconstruct(subtype: Any, shape: Any, code: Any) -> PickledArray:
        del subtype, shape, code
        return PickledArray(budget)

    def scalar(dtype: Any, raw: Any) -> Any:
        return _decode(budget, raw, dtype, (), "C").item()

    def frombuffer(raw: Any, dtype: Any, shape: Any, order: Any) -> PickledArray:
        return PickledArray(budget, _decode(budget, raw, dtype, shape, order))

    table: dict[tuple[str, str], Callable[..., Any]] = {
        ("_codecs", "encode"): encode,
        ("__builtin__", "bytes"): _empty_bytes,
        ("builtins", "bytes"): _empty_bytes,
        ("numpy", "ndarray"): _no_array,
        ("numpy", "dtype"): PickledDtype,
    }
    for core in ("numpy.core", "numpy._core"):
        table[core + ".multiarray", "_reconstruct"] = reconstruct
        table[core + ".multiarray", "scalar"] = scalar
        table[core + ".numeric", "_frombuffer"] = frombuffer
    return {key: Constructor(".".join(key), build) for key, build in table.items()}


def _empty_bytes() -> bytes:
    return b""


def _no_array(*_: Any) -> None:
    raise LogError("a numpy array made by numpy.ndarray() is refused")


def _decode(budget: Budget, raw: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """View ``raw`` as an array after checking that it holds exactly ``shape``."""
    if not isinstance(dtype, PickledDtype) or not isinstance(shape, tuple) or order not in ("C", "F"):
        raise LogError("a numpy array with an unknown dtype, shape or order is refused")
    if len(shape) > _MAX_DIMENSIONS or not all(type(size) is int and 0 <= size < _LARGEST for size in shape):
        raise LogError(f"a numpy array of {len(shape)} dimensions, or of a size that none can have, is refused")
    kind = dtype.dtype()
    if not isinstance(raw, str | bytes | bytearray) or len(raw) != math.prod(shape) * kind.itemsize:
        raise LogError(f"a numpy array of shape {shape!r} and type {kind} does not fit its bytes")
    budget.spend(len(raw))
    content = raw.encode("latin1") if isinstance(raw, str) else raw
    return np.frombuffer(content, dtype=kind).reshape(shape, order=order)
