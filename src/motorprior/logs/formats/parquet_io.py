"""Motor logs on disk: one Parquet file per log, float64, with a strict JSON header and no pickle.

Columns are ``time_s``, ``<channel>_<unit>/<joint>`` such as ``joint_pos_rad/FR_hip``, optionally ``segment``,
``posture`` (an index in `motor_log.POSTURES`) and ``base_roll_rad``, ``base_pitch_rad``. The header is the schema
metadata ``b"motorprior"``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import atomic_path, parse_json, require_keys
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.formats.log_reader import SAY_COLUMNS, LogReader
from motorprior.logs.formats.table_columns import parquet_table
from motorprior.logs.motor_log import BASE_AXES, CODES, JOINT_SERIES, SIGN_CONVENTION, MotorLog
from motorprior.logs.validity import checked

SCHEMA_VERSION = 3
METADATA_KEY = b"motorprior"
REWRITE = "write the log again with this version of motorprior"
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
        LogError: the log breaks a rule of `checked`.
        ArtifactError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(path)
    log = checked(log, where=path)
    columns = _columns(log)
    metadata = {METADATA_KEY: json.dumps(_header(log), sort_keys=True).encode()}
    table = pa.table({name: np.ascontiguousarray(column) for name, column in columns.items()})
    with atomic_path(path) as temporary:
        pq.write_table(table.replace_schema_metadata(metadata), temporary, compression="zstd", row_group_size=2**20)


def read_parquet(path: str | Path) -> MotorLog:
    """Read what `write_log` wrote; every float64 comes back bit for bit.

    Raises:
        LogError: missing or truncated file, another schema version, unit or sign convention, an unknown or missing
            column, or values that `checked` refuses.
    """
    path = Path(path)
    if path.suffix != ".parquet":
        remedy = "convert a recording with `motorprior logs import`, and give the .parquet file that it writes"
        raise LogError(f"a file {path.suffix}, not a motor log (.parquet)", where=path, remedy=remedy)
    table = parquet_table(path, lambda names: names)
    header = _read_header(table.schema.metadata, path)
    wanted = _column_names(header["channels"], tuple(header["joint_names"]))
    _require_columns(table.schema, [name for names in wanted.values() for name in names], path)
    values: dict[str, Any] = {channel: _stack(table, channel, names, path) for channel, names in wanted.items()}
    values |= {key: header[key] for key in ("robot", "motor", "source", "encoder", "gain_unit", "firmware")}
    return checked(MotorLog(joint_names=tuple(header["joint_names"]), **values), where=path)


def has_loads(path: Path) -> bool:
    """Whether a file is a motor log with loads, by its header alone; what cannot be read has none."""
    try:
        return "load_inertia" in _read_header(parquet_table(path, lambda names: []).schema.metadata, path)["channels"]
    except LogError:
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


def _read_header(metadata: dict[bytes, bytes] | None, path: Path) -> dict[str, Any]:
    text = (metadata or {}).get(METADATA_KEY)
    if text is None:
        raise LogError(
            "a Parquet file, but not a motor log: no motorprior header", where=path,
            remedy=f"convert it by `motorprior logs import` {SAY_COLUMNS}", argument="columns",
        )  # fmt: skip
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
    try:
        require_keys(schema.names, wanted, path)
    except ArtifactError as error:
        raise LogError(error.problem.replace("keys", "columns"), where=path, remedy=REWRITE) from error
    for field in schema:
        expected = "int64" if field.name in CODES else "double"
        if str(field.type) != expected:
            raise LogError(f"column {field.name} is {field.type}, not {expected}", where=path, remedy=REWRITE)


def _stack(table: Any, channel: str, names: list[str], path: Path) -> np.ndarray:
    for name in names:
        if empty := table.column(name).null_count:
            raise LogError(f"column {name} has {empty} empty cells", where=path, remedy=REWRITE)
    if channel in ("time", *CODES):
        return table.column(names[0]).to_numpy()
    return np.stack([table.column(name).to_numpy() for name in names], axis=1)
