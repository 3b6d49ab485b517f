"""Files that are complete or absent: atomic writes, strict JSON, safetensors with a JSON header.

An artefact is one safetensors file whose metadata holds one JSON text. No pickle anywhere; unknown
or missing keys are refused, so a typo or a file from the future never loads half-understood.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import socket
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError, cut
from motorprior.files import read_text, require_file

_DTYPES = frozenset(["F64", "F32", "F16", "I64", "I32", "I16", "I8", "U64", "U32", "U16", "U8", "BOOL"])
"""Of the arrays in an artefact; the format has others, some of which numpy lacks."""
MAX_JSON = 15_000_000
"""Bytes of a file; in memory it takes up to 35 times as much."""
MAX_HEADER = 10_000_000
"""Bytes of the header of a file of tensors."""
MAX_TENSORS = 400_000_000
"""Bytes of a file of tensors, which is for a moment in memory twice."""
_SHOWN_KEYS = 8


@contextlib.contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``final``; fsync and rename it on success, delete it on failure.

    A process that is killed in between leaves its temporary file; the next one that writes ``final`` removes it.

    Raises:
        ArtifactError: the folder cannot be created or written, or the disk is full.
    """
    final = Path(final)
    temporary = None
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        remove_half_written(final.parent, final.name)
        ending = f"-{this_host()}-{os.getpid()}{_HALF_WRITTEN}"
        handle, name = tempfile.mkstemp(prefix=f".{_shortened(final.name)}.", suffix=ending, dir=final.parent)
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


def remove_half_written(folder: Path, name: str | None = None) -> None:
    """Remove temporary files of `atomic_path` in a folder whose process is gone: of one file's ``name``, or of all.

    Processes of this machine are looked up. Those of others cannot be: their files count as left behind where ``name``
    is not given, for a stage that has its folder to itself.
    """
    try:
        there = list(folder.iterdir())
    except PermissionError:  # a folder may be written that cannot be listed
        return
    for path in there:
        found = _TEMPORARY.fullmatch(path.name)
        if found is None or (name is not None and found["name"] != _shortened(name)):
            continue
        if is_gone(int(found["pid"])) if found["host"] == this_host() else name is None:
            path.unlink(missing_ok=True)


_HALF_WRITTEN = ".tmp"
_TEMPORARY = re.compile(
    rf"\.(?P<name>.+)\.[^.]+-(?P<host>[0-9a-f]{{8}})-(?P<pid>[0-9]{{1,9}}){re.escape(_HALF_WRITTEN)}", re.DOTALL
)
_LONGEST_NAME = 200
"""Bytes of the final name in the temporary one, which file systems bound at 255."""


def _shortened(name: str) -> str:
    return os.fsencode(name)[:_LONGEST_NAME].decode(errors="ignore")


def this_host() -> str:
    """Short, since file names are bounded."""
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def is_gone(pid: int) -> bool:
    """Whether no process has that number; not known, so False, on systems other than POSIX."""
    if os.name != "posix":
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:  # another user's
        pass
    return False


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


def parse_json(text: str) -> Any:
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


def dotted(table: Mapping[str, Any], within: str = "") -> dict[str, Any]:
    """Dotted name -> value of a table of tables; lists and empty tables are values.

    Args:
        table: as JSON.
        within: beginning of the names, the dot included.
    """
    found: dict[str, Any] = {}
    for name, value in table.items():
        is_table = isinstance(value, Mapping) and value
        found |= dotted(value, f"{within}{name}.") if is_table else {within + name: value}
    return found


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        ArtifactError: the file is missing, no file, longer than `MAX_JSON` or not JSON; NaN and infinity are none.
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
    """Refuse any key too many or too few in the table ``name`` of the file ``where``.

    Raises:
        ArtifactError: names the unknown and the missing keys.
    """
    given, wanted = set(given), set(wanted)
    if given != wanted:
        parts = [f"unknown keys {_listed(given - wanted)}"] if given - wanted else []
        parts += [f"missing keys {_listed(wanted - given)}"] if wanted - given else []
        raise ArtifactError((f"{name}: " if name else "") + " and ".join(parts), where=where, remedy=remedy)


def _listed(keys: set[str]) -> str:
    some = [cut(key, 60) for key in sorted(keys)[:_SHOWN_KEYS]]
    return f"{some} and {len(keys) - len(some)} more" if len(keys) > len(some) else f"{some}"


def tensors_as_bytes(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> bytes:
    """Arrays and a JSON header in the format safetensors; same contents, same bytes."""
    from safetensors.numpy import save

    text = json.dumps(header, sort_keys=True, allow_nan=False)
    arrays = {name: np.asarray(value, order="C") for name, value in tensors.items()}
    return save(arrays, metadata={"motorprior": text})


def write_tensors(path: Path, tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> None:
    """Write arrays and a JSON header as one safetensors file, atomically."""
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
        check: raises an ArtifactError for a header that is not wanted; no tensor is read before it is asked.

    Raises:
        ArtifactError: missing, no file of tensors, truncated, too long, without a header, or with a value, there or in
            a tensor, that is not finite.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    _require_tensors(path)
    try:
        with safe_open(path, "numpy") as file:
            names = file.keys()
            types = {name: file.get_slice(name).get_dtype() for name in names}
            if unknown := sorted(set(types.values()) - _DTYPES):
                raise ArtifactError(f"a tensor is of type {unknown[0]}", where=path, remedy="write it again")
            header = _header((file.metadata() or {}).get("motorprior"), path)
            check(header, path)
            tensors = {name: file.get_tensor(name) for name in types}
    except (SafetensorError, OSError) as error:
        problem = f"not a complete safetensors file ({error})"
        raise ArtifactError(problem, where=path, remedy="write it again") from error
    for name, value in tensors.items():
        if (place := first_not_finite(value)) is not None:
            raise ArtifactError(f"tensor {name}{place} is not finite", where=path, remedy="train it again")
    return tensors, header


def _require_tensors(path: Path) -> None:
    """Refuse, by its size and its first bytes, what is no file of tensors."""
    size = require_file(path)
    with open(path, "rb") as file:
        start = file.read(9)
    length = int.from_bytes(start[:8], "little")
    if start[8:] != b"{" or length > MAX_HEADER:
        kind = "a text, such as a table" if start.isascii() and b"\0" not in start else "other data"
        kind = kind if size else "nothing"
        remedy = "give a .safetensors file that motorprior wrote: `identify` makes a prior of a log, `walk` a policy"
        raise ArtifactError(f"not a complete safetensors file, but {kind}", where=path, remedy=remedy)
    if size > MAX_TENSORS:
        problem = f"{size} bytes, more than the {MAX_TENSORS} that a file of tensors may have"
        raise ArtifactError(problem, where=path, remedy="copy it again from its source")


def _header(text: str | None, path: Path) -> dict[str, Any]:
    if text is None:
        raise ArtifactError("no motorprior header", where=path, remedy="use a file motorprior wrote")
    try:
        header = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"its header is not JSON ({error})", where=path, remedy="write it again") from error
    if not isinstance(header, dict):
        raise ArtifactError("its header is not a table", where=path, remedy="write it again")
    return header


def first_not_finite(value: np.ndarray) -> list[int] | None:
    """Indices of the first value of an array that is NaN or infinite; None if there is none."""
    finite = np.isfinite(value)
    return None if finite.all() else np.argwhere(~finite)[0].tolist()
