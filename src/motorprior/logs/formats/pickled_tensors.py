"""Stand-ins for the PyTorch names that appear in the pickle of a tensor file: where a tensor's numbers are, no more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

from motorprior.exceptions import LogError, shown
from motorprior.logs.formats.pickled_arrays import Constructor

STORAGES = {
    "DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1",
}  # fmt: skip
"""PyTorch's names of arrays of one type, and numpy's codes."""
BFLOAT16 = "BFloat16Storage"
"""A type that numpy does not have."""
_MAX_DIMENSIONS = 8
_LARGEST = 2**40
"""Of a size, a step or an offset: the product of longer numbers could take hours."""


@dataclass(frozen=True, slots=True)
class PickledStorage:
    """The file of numbers ``data/KEY`` of a tensor file: numpy's type code, and how many."""

    key: str
    code: str
    count: int

    def __setstate__(self, state: Any) -> None:
        """See `PickledTensor`."""
        raise LogError("a storage that is changed after it was made is refused")


@dataclass(frozen=True, slots=True)
class PickledTensor:
    """Which numbers of a storage are a tensor: the first one's index, sizes, and steps per dimension."""

    storage: PickledStorage
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]

    def __setstate__(self, state: Any) -> None:
        """Refuse what a pickle says after the tensor was checked: it could point anywhere in memory."""
        raise LogError("a tensor that is changed after it was made is refused")


def storage_of(reference: Any) -> PickledStorage:
    """What the pickle refers to: ("storage", type, key, device, count)."""
    if not isinstance(reference, tuple) or len(reference) != 5 or reference[0] != "storage":
        raise LogError(f"the pickle refers to {shown(reference)}, which is no storage of a tensor")
    _, kind, key, _, count = reference
    name = repr(kind).removeprefix("torch.") if isinstance(kind, Constructor) else ""
    if name == BFLOAT16:
        raise LogError("it holds numbers of type bfloat16", remedy="save them as float32, by tensor.float()")
    code = STORAGES.get(name)
    if code is None or not isinstance(key, str) or not key.isalnum() or not _whole((count,)):
        raise LogError(f"a storage {shown(key)} of {shown(count)} numbers of type {shown(kind)} is refused")
    return PickledStorage(key, code, count)


def tensor_constructors() -> Mapping[tuple[str, str], Constructor]:
    """Everything of PyTorch that a pickle may name."""
    table: dict[tuple[str, str], Callable[..., Any]] = {
        ("torch._utils", "_rebuild_tensor_v2"): _tensor,
        ("collections", "OrderedDict"): _empty_dict,
        **{("torch", name): _no_storage for name in (*STORAGES, BFLOAT16)},
    }
    return {key: Constructor(".".join(key), build) for key, build in table.items()}


def require_inside(tensor: PickledTensor) -> None:
    """Refuse a tensor that is not within its storage.

    Raises:
        LogError: names its size, its steps and the storage's length.
    """
    size, stride, count = tensor.size, tensor.stride, tensor.storage.count
    if len(size) != len(stride) or len(size) > _MAX_DIMENSIONS:
        raise LogError(f"a tensor of {len(size)} dimensions with {len(stride)} steps is refused")
    if prod(size) > count:
        raise LogError(f"a tensor of size {size!r}, steps {stride!r} in {count} numbers is refused")
    last = tensor.offset + sum((length - 1) * step for length, step in zip(size, stride, strict=True))
    if prod(size) and last >= count:
        raise LogError(f"a tensor of size {size!r} ends at number {last}, its storage has {count}")


def _tensor(storage: Any, offset: Any, size: Any, stride: Any, requires_grad: Any = False, hooks: Any = None) -> Any:
    del requires_grad, hooks
    if not isinstance(storage, PickledStorage) or not _whole((offset,)) or not _whole(size) or not _whole(stride):
        raise LogError("a tensor of unknown make is refused")
    made = PickledTensor(storage, offset, size, stride)
    require_inside(made)
    return made


def _whole(values: Any) -> bool:
    return isinstance(values, tuple) and all(type(value) is int and 0 <= value < _LARGEST for value in values)


def _empty_dict() -> dict[Any, Any]:
    return {}


def _no_storage(*_: Any) -> None:
    raise LogError("a storage made by the pickle itself is refused")
