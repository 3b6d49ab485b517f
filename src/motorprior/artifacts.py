"""Files that are complete or absent: atomic writes, strict JSON, safetensors with a JSON header.

An artefact is one safetensors file whose metadata holds one JSON text. No file is a pickle. Unknown or missing keys are
errors, so that neither a typo nor a file of a newer version is read wrongly.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError, cut
from motorprior.files import read_text, require_file

MAX_JSON = 15_000_000  # bytes of a file; parsed JSON needs up to 35 times as much memory
MAX_HEADER = 10_000_000  # bytes of the header of a safetensors file
MAX_TENSORS = 400_000_000  # bytes of a safetensors file, which is briefly in memory twice


@contextlib.contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Yield a temporary path next to ``final``; fsync and rename it on success, delete it on failure.

    Raises:
        ArtifactError: the folder cannot be created or written, or the disk is full.
    """
    final, temporary = Path(final), None
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=".tmp", dir=final.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, final)
    except OSError as error:
        raise ArtifactError(
            f"cannot write ({error.strerror or error})", where=final,
            remedy="choose a writable folder with free space",
        ) from error  # fmt: skip
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as sorted, indented JSON, atomically.

    Raises:
        ValueError: NaN or infinity.
    """
    write_text(path, json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n")


def parse_json(text: str) -> Any:
    """Standard JSON, in which every number is finite; Python's parser also accepts NaN, Infinity and 1e999.

    Raises:
        ValueError: not JSON, or a number that is not finite.
    """
    return json.loads(text, parse_constant=_finite, parse_float=_finite)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def dotted(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested tables: dotted name -> value; lists and empty tables are values."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        is_table = isinstance(value, Mapping) and value
        found |= dotted(value, f"{prefix}{name}.") if is_table else {prefix + name: value}
    return found


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        ArtifactError: missing, not a file, larger than `MAX_JSON`, or not JSON; NaN and infinity are not JSON.
    """
    try:
        return parse_json(read_text(Path(path), MAX_JSON))
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid JSON ({error})", where=path, remedy="write it again") from error


def require_keys(
    given: Iterable[str],
    wanted: Iterable[str],
    where: str | Path | None,
    remedy: str = "use a file written by this version of motorprior",
    name: str = "",
) -> None:
    """Check that the table ``name`` of the file ``where`` has exactly the wanted keys.

    Raises:
        ArtifactError: names up to eight unknown and missing keys.
    """
    given, wanted = set(given), set(wanted)
    problems = [
        f"{kind} keys {[cut(key, 60) for key in sorted(keys)[:8]]}"
        for kind, keys in (("unknown", given - wanted), ("missing", wanted - given))
        if keys
    ]
    if problems:
        raise ArtifactError((f"{name}: " if name else "") + " and ".join(problems), where=where, remedy=remedy)


def tensors_as_bytes(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> bytes:
    """Arrays and a JSON header in the safetensors format; the same contents give the same bytes."""
    from safetensors.numpy import save

    text = json.dumps(header, sort_keys=True, allow_nan=False)
    arrays = {name: np.asarray(value, order="C") for name, value in tensors.items()}
    return save(arrays, metadata={"motorprior": text})


def write_tensors(path: Path, tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    """Write arrays and a JSON header as one safetensors file, atomically.

    Raises:
        ArtifactError: larger than `MAX_TENSORS`, or it cannot be written.
    """
    contents = tensors_as_bytes(tensors, header)
    if len(contents) > MAX_TENSORS:
        raise ArtifactError(f"{len(contents)} bytes, more than {MAX_TENSORS}", where=path, remedy="use shorter logs")
    with atomic_path(path) as temporary:
        temporary.write_bytes(contents)


def read_tensors(
    path: Path, check: Callable[[dict[str, Any], Path], None] = lambda header, path: None
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read what `write_tensors` wrote.

    Args:
        path: the file.
        check: called with the header before any tensor is read; raises an ArtifactError to reject the file.

    Raises:
        ArtifactError: missing, not a safetensors file, truncated, too large, without a motorprior header, or with a
            value in the header or in a tensor that is not finite.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    _require_tensors(path)
    try:
        with safe_open(path, "numpy") as file:
            header = _header((file.metadata() or {}).get("motorprior"), path)
            check(header, path)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, TypeError) as error:  # TypeError: a dtype that numpy lacks
        problem = f"not a complete safetensors file ({error})"
        raise ArtifactError(problem, where=path, remedy="write it again") from error
    for name, value in tensors.items():
        if (index := first_not_finite(value)) is not None:
            raise ArtifactError(f"tensor {name}{index} is not finite", where=path, remedy="train it again")
    return tensors, header


def _require_tensors(path: Path) -> None:
    """Check size and first bytes: safetensors would allocate the size that a damaged header states."""
    size = require_file(path)
    with open(path, "rb") as file:
        start = file.read(9)
    if start[8:] != b"{" or int.from_bytes(start[:8], "little") > MAX_HEADER:
        remedy = "give a .safetensors file that motorprior wrote: `identify` writes a prior, `walk` a policy"
        raise ArtifactError("not a complete safetensors file", where=path, remedy=remedy)
    if size > MAX_TENSORS:
        problem = f"{size} bytes, more than the maximum of {MAX_TENSORS}"
        raise ArtifactError(problem, where=path, remedy="copy it again from its source")


def _header(text: str | None, path: Path) -> dict[str, Any]:
    if text is None:
        raise ArtifactError("no motorprior header", where=path, remedy="use a file that motorprior wrote")
    try:
        header = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"its header is not JSON ({error})", where=path, remedy="write it again") from error
    if not isinstance(header, dict):
        raise ArtifactError("its header is not a table", where=path, remedy="write it again")
    return header


def first_not_finite(value: np.ndarray) -> list[int] | None:
    """Indices of the first NaN or infinity in an array; None if all values are finite."""
    finite = np.isfinite(value)
    return None if finite.all() else np.argwhere(~finite)[0].tolist()
