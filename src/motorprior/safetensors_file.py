"""Reading safetensors with numpy alone: a robot's computer has nothing else, and a policy must get there.

    8 bytes      N, little-endian
    N bytes      JSON: name -> {dtype, shape, data_offsets: [begin, end]}; "__metadata__" -> texts
    the rest     the arrays, row-major, little-endian, one after the other without a gap

Format: huggingface/safetensors, docs. As strict as that library, which writes the files.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

LARGEST_HEADER = 100_000_000
_DTYPES = {
    "F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "|i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "|u1", "BOOL": "|b1",
}  # fmt: skip


def parse_json(text: str | bytes) -> Any:
    """JSON in which every number is finite, as the standard has it: Python alone reads NaN, Infinity and 1e999.

    Raises:
        ValueError: not JSON, or a number that is not finite.
    """
    return json.loads(text, parse_constant=_finite, parse_float=_finite)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def parse_safetensors(data: bytes) -> tuple[str | None, dict[str, np.ndarray]]:
    """The text under ``motorprior`` in the metadata, and every array.

    Raises:
        ValueError: truncated, too long, with a gap or an overlap, or a header that makes no sense.
    """
    if len(data) < 8:
        raise ValueError("it ends within its first 8 bytes")
    size = int.from_bytes(data[:8], "little")
    if size > min(LARGEST_HEADER, len(data) - 8):
        raise ValueError(f"its header is said to have {size} bytes, the file has {len(data)}")
    try:
        header = parse_json(data[8 : 8 + size])
    except RecursionError as error:
        raise ValueError("its header is nested too deeply") from error
    if not isinstance(header, dict):
        raise ValueError("its header is not a table")
    metadata = header.pop("__metadata__", {})
    text = metadata.get("motorprior") if isinstance(metadata, dict) else None
    return text if isinstance(text, str) else None, _arrays(header, memoryview(data)[8 + size :])


def _arrays(header: dict[str, Any], body: memoryview) -> dict[str, np.ndarray]:
    found, end_before = {}, 0
    for name, entry in sorted(header.items(), key=lambda item: _offsets(*item)):
        begin, end = _offsets(name, entry)
        dtype, shape = entry.get("dtype"), entry.get("shape")
        if not isinstance(dtype, str) or dtype not in _DTYPES:
            raise ValueError(f"tensor {name} is of the unknown type {dtype!r}")
        if not isinstance(shape, list) or not all(type(length) is int and length >= 0 for length in shape):
            raise ValueError(f"tensor {name} has the shape {shape!r}")
        kind = np.dtype(_DTYPES[dtype])
        if begin != end_before or end - begin != math.prod(shape) * kind.itemsize or end > len(body):
            raise ValueError(f"tensor {name} does not fill bytes {begin} to {end} of {len(body)}")
        found[name] = np.frombuffer(body[begin:end], kind).reshape(shape).copy()
        end_before = end
    if end_before != len(body):
        raise ValueError(f"{len(body) - end_before} bytes belong to no tensor")
    return found


def _offsets(name: str, entry: Any) -> tuple[int, int]:
    offsets = entry.get("data_offsets") if isinstance(entry, dict) else None
    if not isinstance(offsets, list) or len(offsets) != 2 or not all(type(value) is int for value in offsets):
        raise ValueError(f"tensor {name} has no offsets")
    return offsets[0], offsets[1]
