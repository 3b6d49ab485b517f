"""Stand-ins for the PyTorch names that appear in the pickle of a tensor file: where a tensor's numbers are, no more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

from motorprior.exceptions import LogError
from motorprior.logs.pickled_arrays import Constructor

STORAGES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1",
}  # fmt: skip
"""PyTorch's names of arrays of one type, and numpy's codes."""
_MAX_DIMENSIONS = 8


@dataclass(frozen=True)
class PickledStorage:
    """The file of numbers ``data/KEY`` of a tensor file: numpy's type code, and how many."""

    key: str
    code: str
    count: int


@dataclass(frozen=True)
class PickledTensor:
    """Which numbers of a storage are a tensor: the first one's index, sizes, and steps per dimension."""

    storage: PickledStorage
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


def storage_of(reference: Any) -> PickledStorage:
    """What the pickle refers to: ("storage", type, key, device, count)."""
    if not isinstance(reference, tuple) or len(reference) != 5 or reference[0] != "storage":
        raise LogError(f"the pickle refers to {str(reference)[:60]!r}, which is no storage of a tensor")
    _, kind, key, _, count = reference
    code = STORAGES.get(repr(kind).removeprefix("torch.")) if isinstance(kind, Constructor) else None
    if code is None or not isinstance(key, str) or not key.isalnum() or type(count) is not int or count < 0:
        raise LogError(f"a storage {key!r} of {count!r} numbers of type {kind!r} is refused")
    return PickledStorage(key, code, count)


def tensor_constructors() -> Mapping[tuple[str, str], Constructor]:
    """Everything of PyTorch that a pickle may name."""
    table: dict[tuple[str, str], Callable[..., Any]] = {
        ("torch._utils", "_rebuild_tensor_v2"): _tensor,
        ("collections", "OrderedDict"): _empty_dict,
        **{("torch", name): _no_storage for name in STORAGES},
    }
    return {key: Constructor(".".join(key), build) for key, build in table.items()}


def _tensor(storage: Any, offset: Any, size: Any, stride: Any, requires_grad: Any = False, hooks: Any = None) -> Any:
    del requires_grad, hooks
    if not isinstance(storage, PickledStorage) or not _whole((offset,)) or not _whole(size) or not _whole(stride):
        raise LogError("a tensor of unknown make is refused")
    if len(size) != len(stride) or len(size) > _MAX_DIMENSIONS or prod(size) > storage.count:
        raise LogError(f"a tensor of size {size!r}, steps {stride!r} in {storage.count} numbers is refused")
    last = offset + sum((length - 1) * step for length, step in zip(size, stride, strict=True))
    if prod(size) and last >= storage.count:
        raise LogError(f"a tensor of size {size!r} ends at number {last}, its storage has {storage.count}")
    return PickledTensor(storage, offset, size, stride)


def _whole(values: Any) -> bool:
    return isinstance(values, tuple) and all(type(value) is int and value >= 0 for value in values)


def _empty_dict() -> dict[Any, Any]:
    return {}


def _no_storage(*_: Any) -> None:
    raise LogError("a storage made by the pickle itself is refused")
