"""Files: read with one clear error, written whole or not at all.

Texts are JSON or TOML; arrays are safetensors with a JSON header.
"""

import gzip
import json
import math
import os
import tomllib
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from motorprior.bounds import first_not_finite
from motorprior.exceptions import ArtifactError, MotorPriorError

MAX_BYTES = 1_000_000_000  # maximum size of a file, packed and unpacked; each is held in memory


def require_file(path: Path, error: type[MotorPriorError] = ArtifactError) -> None:
    """Raise an ``error`` unless the path is a file of at most MAX_BYTES."""
    if not path.exists():
        raise error("no such file", where=path, remedy="check the path")
    if not path.is_file():
        raise error("not a file", where=path, remedy="give a file")
    require_size(path.stat().st_size, path, error)


def require_size(size: int, path: Path, error: type[MotorPriorError] = ArtifactError) -> None:
    """Raise an ``error`` if a file, or its unpacked content, has more than MAX_BYTES."""
    if size <= MAX_BYTES:
        return
    remedy = "split it, or check that it is the right file"
    raise error(f"more than {MAX_BYTES} bytes", where=path, remedy=remedy)


def read_bytes(path: Path, error: type[MotorPriorError] = ArtifactError) -> bytes:
    """Content of a file, unpacked if it is a ``.gz``.

    Raises an ``error`` if the file is missing, damaged or larger than MAX_BYTES.
    """
    require_file(path, error)
    open_file = gzip.open if path.suffix == ".gz" else Path.open
    try:
        with open_file(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as reason:
        problem = f"unreadable or damaged ({reason})"
        raise error(problem, where=path, remedy="copy it again from its source") from reason
    require_size(len(data), path, error)
    return data


def read_text(path: Path, error: type[MotorPriorError] = ArtifactError) -> str:
    """Text of a UTF-8 file, with or without byte order mark.

    Raises an ``error`` as `read_bytes`, or if the file is not UTF-8.
    """
    try:
        return read_bytes(path, error).decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        problem = f"not a text file ({reason})"
        raise error(problem, where=path, remedy="save it as UTF-8") from reason


def read_toml(path: Path, remedy: str) -> dict[str, Any]:
    """Table of a TOML file; raises ArtifactError as `read_text`, or if it is not TOML."""
    try:
        return tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy=remedy) from error


def parse_json(text: str) -> Any:
    """Value of a standard JSON text; raises ValueError.

    Python's own parser also accepts NaN, Infinity and 1e999.
    """
    return json.loads(text, parse_constant=_finite, parse_float=_finite)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is not a finite number")
    return value


def read_json(path: Path) -> Any:
    """Value of a JSON file; raises ArtifactError as `read_text`, or if `parse_json` fails."""
    try:
        return parse_json(read_text(path))
    except (ValueError, RecursionError) as error:
        problem = f"not valid JSON ({error})"
        raise ArtifactError(problem, where=path, remedy="write it again") from error


@contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Yield a temporary path next to ``final``, which is renamed on success and deleted on failure.

    Raises ArtifactError if the folder cannot be created or written, or the disk is full.
    """
    temporary = final.with_name(f".{uuid4().hex}.tmp")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        temporary.replace(final)
    except OSError as error:
        problem = f"cannot write ({error.strerror or error})"
        remedy = "choose a writable folder with free space"
        raise ArtifactError(problem, where=final, remedy=remedy) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as sorted, indented JSON, atomically; raises ValueError if not finite."""
    text = json.dumps(value, indent=1, sort_keys=True, allow_nan=False)
    write_text(path, f"{text}\n")


def tensors_as_bytes(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> bytes:
    """Arrays and a JSON header in the safetensors format; the same contents give the same bytes."""
    from safetensors.numpy import save

    text = json.dumps(header, sort_keys=True, allow_nan=False)
    arrays = {name: np.asarray(value, order="C") for name, value in tensors.items()}
    return save(arrays, metadata={"motorprior": text})


def write_tensors(path: Path, tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    """Write arrays and a JSON header as one safetensors file, atomically."""
    contents = tensors_as_bytes(tensors, header)
    with atomic_path(path) as temporary:
        temporary.write_bytes(contents)


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and header of `write_tensors`.

    Raises ArtifactError if the file is missing or damaged, or has a number that is not finite.
    """
    from safetensors import SafetensorError, safe_open

    require_file(path)
    try:
        with safe_open(path, "numpy") as file:
            metadata = file.metadata() or {}
            header = parse_json(metadata["motorprior"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, TypeError, KeyError, ValueError, RecursionError) as error:
        remedy = (
            "give a .safetensors file that motorprior wrote: "
            "`identify` writes a prior, `walk` a policy"
        )
        problem = f"not a complete safetensors file ({error})"
        raise ArtifactError(problem, where=path, remedy=remedy) from error

    for name, value in tensors.items():
        index = first_not_finite(value)
        if index is not None:
            problem = f"tensor {name}{index} is not finite"
            raise ArtifactError(problem, where=path, remedy="train it again")
    return tensors, header
