"""Arrays of numbers in nested tables and lists, by names with dots, such as ``run.0.joint_pos``."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_MAX_ITEMS = 100  # maximum length of a list whose items are separate arrays


def named_arrays(content: Any) -> dict[str, np.ndarray]:
    """The arrays in a value by name; a value that is an array itself is named ``data``.

    Arrays without numbers are left out. A list with a table of arrays per step is stacked.
    """
    arrays: dict[str, np.ndarray] = {}
    _collect("", content, arrays)
    return arrays


def _collect(name: str, value: Any, arrays: dict[str, np.ndarray]) -> None:
    """Add the arrays in a value to ``arrays``, by names that begin with ``name``."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {field: value[field] for field in value.dtype.names}

    if isinstance(value, Mapping):
        for key, item in value.items():
            _collect(_joined(name, key), item, arrays)
        return
    if not isinstance(value, list | tuple | np.ndarray):
        return

    is_list = isinstance(value, list | tuple)
    if is_list and len(value) > 1 and _have_equal_keys(value):
        for key in value[0]:
            _collect(_joined(name, key), [step[key] for step in value], arrays)
        return

    array = _as_array(value)
    if array.dtype.kind in "biuf" and array.size:
        arrays[name or "data"] = array
    elif is_list and len(value) <= _MAX_ITEMS:
        for index, item in enumerate(value):
            _collect(_joined(name, index), item, arrays)


def _joined(name: str, key: object) -> str:
    return f"{name}.{key}".removeprefix(".")


def _as_array(value: Any) -> np.ndarray:
    """The values as an array; a single object if they have different lengths."""
    try:
        return np.asarray(value)
    except ValueError:
        return np.zeros((), object)


def _have_equal_keys(tables: Sequence[Any]) -> bool:
    return all(
        isinstance(table, Mapping) and table and table.keys() == tables[0].keys()
        for table in tables
    )
