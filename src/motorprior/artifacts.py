"""Files that are complete or absent: atomic writes, strict JSON, safetensors with a JSON header.

An artefact is one safetensors file whose metadata holds one JSON text. No pickle anywhere; unknown
or missing keys are refused, so a typo or a file from the future never loads half-understood.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.safetensors_file import parse_json, parse_safetensors


@contextlib.contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``final``; fsync and rename it on success, delete it on failure.

    Raises:
        ArtifactError: the folder cannot be created or written, or the disk is full.
    """
    final = Path(final)
    temporary = None
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{final.name}.", dir=final.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, final)
    except OSError as error:
        raise ArtifactError(
            f"cannot write ({error.strerror or error})",
            where=final,
            remedy="choose another folder or file, one that is writable and has free space",
        ) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as sorted, indented JSON, atomically. NaN and infinity are refused."""
    write_text(path, json_text(value))


def json_text(value: Any) -> str:
    """``value`` as `write_json` writes it."""
    return json.dumps(value, indent=1, sort_keys=True, allow_nan=False) + "\n"


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        ArtifactError: the file is missing or is not JSON; NaN and infinity are none.
    """
    try:
        return parse_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid JSON ({error})", where=path, remedy="write it anew") from error


def require_keys(given: Iterable[str], wanted: Iterable[str], where: str | Path) -> None:
    """Refuse any key too many or too few.

    Raises:
        ArtifactError: names the unknown and the missing keys.
    """
    given, wanted = set(given), set(wanted)
    if given != wanted:
        parts = [f"unknown keys {sorted(given - wanted)}"] if given - wanted else []
        parts += [f"missing keys {sorted(wanted - given)}"] if wanted - given else []
        raise ArtifactError(" and ".join(parts), where=where, remedy="use a file written by this version of motorprior")


def tensors_as_bytes(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> bytes:
    """Arrays and a JSON header in the format safetensors; same contents, same bytes."""
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
    """Read what `write_tensors` wrote.

    Raises:
        ArtifactError: missing, truncated, without a header, or with a value, there or in a tensor, that is not finite.
    """
    if not Path(path).is_file():
        raise ArtifactError("no such file", where=path, remedy="check the path")
    try:
        text, tensors = parse_safetensors(Path(path).read_bytes())
    except (ValueError, OSError) as error:
        raise ArtifactError(f"not a complete safetensors file ({error})", where=path, remedy="write it anew") from error
    if text is None:
        raise ArtifactError("no motorprior header", where=path, remedy="use a file motorprior wrote")
    for name, value in tensors.items():
        if not np.all(np.isfinite(value)):
            bad = np.argwhere(~np.isfinite(value))[0].tolist()
            raise ArtifactError(f"tensor {name}{bad} is not finite", where=path, remedy="train it anew")
    try:
        header = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"its header is not JSON ({error})", where=path, remedy="write it anew") from error
    if not isinstance(header, dict):
        raise ArtifactError("its header is not a table", where=path, remedy="write it anew")
    return tensors, header
