"""Motor logs on disk: one Parquet file per log, float64, with a strict JSON header and no pickle.

Columns are ``time_s``, ``<channel>_<unit>/<joint>`` such as ``joint_pos_rad/FR_hip``, optionally
``segment``, ``posture`` (a place in `motor_log.POSTURES`) and ``base_roll_rad``, ``base_pitch_rad``. The header stands
in the schema metadata under ``b"motorprior"``.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import atomic_path, parse_json, require_keys
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.formats.log_reader import SAY_COLUMNS, LogReader
from motorprior.logs.formats.log_size import MAX_LOG_NUMBERS, most_rows, require_log_size
from motorprior.logs.formats.parquet_pages import require_parquet, require_small_pages
from motorprior.logs.motor_log import BASE_AXES, CODES, JOINT_SERIES, SIGN_CONVENTION, MotorLog
from motorprior.logs.validity import checked
from motorprior.outside_files import require_file

SCHEMA_VERSION = 3
METADATA_KEY = b"motorprior"
MAX_HEADER = 1_000_000
"""Bytes."""
REWRITE = "write the log again with this version of motorprior"
_GROUP = 2**20
"""Rows that are written at once: beside a large log there is no second copy of it."""
_OPTIONAL = (*CODES, "base_orientation")
_HEADER_KEYS = (
    *("schema_version", "units", "sign_convention", "robot", "motor"),
    *("source", "joint_names", "channels", "encoder", "gain_unit", "firmware"),
)


def write_log(path: str | Path, log: MotorLog) -> None:
    """Check the log and write it; the file appears complete or not at all.

    Args:
        path: a .parquet file.
        log: in SI units.

    Raises:
        LogError: the log breaks a rule of `checked`, or has more numbers than `read_parquet` takes.
        ArtifactError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(path)
    log = checked(log, where=path)
    require_log_size(log, _present(log), path)
    columns = _columns(log)
    metadata = {METADATA_KEY: json.dumps(_header(log), sort_keys=True).encode()}
    schema = pa.schema([(name, pa.from_numpy_dtype(column.dtype)) for name, column in columns.items()], metadata)
    with atomic_path(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        for first in range(0, log.num_rows, _GROUP):
            rows = slice(first, first + _GROUP)
            part = {name: np.ascontiguousarray(column[rows]) for name, column in columns.items()}
            writer.write_table(pa.table(part, schema=schema))


def read_parquet(path: str | Path) -> MotorLog:
    """Read what `write_log` wrote; every float64 comes back bit for bit.

    Raises:
        LogError: missing or truncated file, another schema version, an unknown or missing column, another
            unit or sign convention, more than `log_size.MAX_LOG_NUMBERS` numbers, or values that `checked` refuses.
    """
    path = Path(path)
    with _opened(path) as (parquet, header, wanted):  # channel by channel: beside the log there is room for one
        values: dict[str, Any] = {channel: _stack(parquet, channel, names, path) for channel, names in wanted.items()}
    values |= {key: header[key] for key in ("robot", "motor", "source", "encoder", "gain_unit", "firmware")}
    return checked(MotorLog(joint_names=tuple(header["joint_names"]), **values), where=path)


def has_loads(path: Path) -> bool:
    """Whether a file is a motor log with loads, by its header alone; what cannot be read has none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        require_parquet(path)
        with pq.ParquetFile(path) as parquet:
            return "load_inertia" in _read_header(parquet.schema_arrow.metadata, path)["channels"]
    except (LogError, pa.ArrowException, OSError):
        return False


PARQUET = LogReader("motor log", (".parquet",), lambda path: True, lambda path, robot: read_parquet(path))


def _columns(log: MotorLog) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    for channel, names in _column_names(_present(log), log.joint_names).items():
        values = np.reshape(getattr(log, channel), (log.num_rows, len(names)))
        columns |= {name: values[:, index] for index, name in enumerate(names)}
    return columns


def _present(log: MotorLog) -> list[str]:
    return [name for name in (*JOINT_SERIES, *_OPTIONAL) if getattr(log, name) is not None]


def _column_names(present: list[str], joint_names: tuple[str, ...]) -> dict[str, list[str]]:
    """Column names of ``time`` and of each channel present, in file order."""
    names = {"time": ["time_s"]}
    for channel in present:
        if channel in CODES:
            names[channel] = [channel]
        elif channel == "base_orientation":
            names[channel] = [f"base_{axis}_rad" for axis in BASE_AXES]
        else:
            names[channel] = [f"{channel}_{JOINT_SERIES[channel]}/{joint}" for joint in joint_names]
    return names


def _units() -> dict[str, str]:
    return {"time": "s", **JOINT_SERIES, "base_orientation": "rad"}


def _header(log: MotorLog) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "units": _units(),
        "sign_convention": SIGN_CONVENTION,
        "robot": log.robot,
        "motor": log.motor,
        "source": log.source,
        "joint_names": list(log.joint_names),
        "channels": _present(log),
        "encoder": log.encoder,
        "gain_unit": log.gain_unit,
        **({"firmware": dict(log.firmware)} if log.firmware else {}),
    }


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, Any], dict[str, list[str]]]]:
    """The open file, its header and the columns of each channel, if they and its size are those of a motor log."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    require_file(path, LogError)
    if path.suffix != ".parquet":
        remedy = "make one of it with `motorprior logs import`, and give the .parquet file that this writes"
        if path.suffix == ".safetensors":
            remedy = "this is what was made of logs: give the logs themselves"
        raise LogError(
            f"a file {path.suffix or 'without an ending'}, not a motor log (.parquet)", where=path, remedy=remedy
        )
    require_parquet(path)
    try:
        with pq.ParquetFile(path) as parquet:  # not a file of Python's: a thread of Arrow's may outlive Python
            header = _read_header(parquet.schema_arrow.metadata, path)
            wanted = _column_names(header["channels"], tuple(header["joint_names"]))
            _require_columns(parquet.schema_arrow, [name for names in wanted.values() for name in names], path)
            most, rows = most_rows(columns := len(parquet.schema_arrow.names)), parquet.metadata.num_rows
            if rows > most:
                problem = f"{rows:,} rows of {columns} numbers, and a motor log has at most {most:,} such rows"
                raise LogError(problem, where=path, remedy="split the recording, or import it with a longer period")
            require_small_pages(path, set(parquet.schema_arrow.names), most=MAX_LOG_NUMBERS)
            yield parquet, header, wanted
    except (pa.ArrowException, OSError) as error:
        raise LogError(
            f"not a complete Parquet file ({error})",
            where=path,
            remedy="copy or record it again; import raw logs with `motorprior logs import`",
        ) from error


def _read_header(metadata: dict[bytes, bytes] | None, path: Path) -> dict[str, Any]:
    text = (metadata or {}).get(METADATA_KEY)
    if text is None:
        raise LogError(
            "a Parquet file, but no motor log: there is no motorprior header", where=path,
            remedy=f"make one of it by `motorprior logs import` {SAY_COLUMNS}", argument="columns",
        )  # fmt: skip
    if len(text) > MAX_HEADER:
        raise LogError(f"its header has {len(text)} bytes, more than {MAX_HEADER}", where=path, remedy=REWRITE)
    try:
        header = parse_json(text.decode())
    except (ValueError, RecursionError) as error:
        raise LogError(f"its header is not JSON ({error})", where=path, remedy=REWRITE) from error
    version = header.get("schema_version") if isinstance(header, dict) else None
    if version != SCHEMA_VERSION:
        raise LogError(
            f"log schema version {version!r}, this motorprior reads {SCHEMA_VERSION}",
            where=path,
            remedy="use the motorprior that wrote it, or " + REWRITE,
        )
    header = {"firmware": {}} | header  # where none is stated, nothing is written
    try:
        require_keys(header, _HEADER_KEYS, path)
    except ArtifactError as error:
        raise LogError(f"header: {error.problem}", where=path, remedy=REWRITE) from error
    _check_header(header, path)
    return header


def _check_header(header: dict[str, Any], path: Path) -> None:
    if (said := header["sign_convention"]) != SIGN_CONVENTION:
        raise LogError(f"sign_convention {said!r}, expected {SIGN_CONVENTION!r}", where=path, remedy=REWRITE)
    for key in ("robot", "motor", "source", "encoder", "gain_unit"):
        if not isinstance(header[key], str):
            raise LogError(f"header: {key} {header[key]!r} is not text", where=path, remedy=REWRITE)
    if not isinstance(header["firmware"], dict):
        raise LogError(f"header: firmware {repr(header['firmware'])[:300]} is no table", where=path, remedy=REWRITE)
    for key, allowed in (("joint_names", None), ("channels", (*JOINT_SERIES, *_OPTIONAL))):
        values = header[key]
        known = isinstance(values, list) and all(isinstance(value, str) for value in values)
        if not known or len(set(values)) != len(values) or (allowed and not set(values) <= set(allowed)):
            raise LogError(f"header: {key} {repr(values)[:300]} is not understood", where=path, remedy=REWRITE)
    if missing := {"position_target", "joint_pos"} - set(header["channels"]):
        raise LogError(f"header: channels lack {sorted(missing)}", where=path, remedy=REWRITE)
    _check_units(header["units"], header["channels"], path)


def _check_units(said: Any, present: Any, path: Path) -> None:
    """Refuse other units than ours; a log that an older version wrote lacks those of channels that came later."""
    wanted = _units()
    known = isinstance(said, dict) and said.keys() <= wanted.keys() and set(present) - {*CODES} <= said.keys()
    if not known or said != {name: wanted[name] for name in said}:
        raise LogError(f"units {said!r}, expected {wanted!r}", where=path, remedy=REWRITE)


def _require_columns(schema: Any, wanted: list[str], path: Path) -> None:
    if twice := sorted({name for name, count in Counter(schema.names).items() if count > 1}):
        raise LogError(f"more than one column {twice[0]}", where=path, remedy=REWRITE)
    try:
        require_keys(schema.names, wanted, path)
    except ArtifactError as error:
        raise LogError(error.problem.replace("keys", "columns"), where=path, remedy=REWRITE) from error
    for field in schema:
        expected = "int64" if field.name in CODES else "double"
        if str(field.type) != expected:
            raise LogError(f"column {field.name} is {field.type}, not {expected}", where=path, remedy=REWRITE)


def _stack(parquet: Any, channel: str, names: list[str], path: Path) -> np.ndarray:
    table = parquet.read(columns=names)
    for name in names:
        if empty := table.column(name).null_count:
            raise LogError(f"column {name} has {empty} empty cells", where=path, remedy=REWRITE)
    if channel in ("time", *CODES):
        return table.column(names[0]).to_numpy()
    return np.stack([table.column(name).to_numpy() for name in names], axis=1)
