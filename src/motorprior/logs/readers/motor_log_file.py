"""Motor logs on disk: one Parquet file per log, float64, with a strict JSON header.

Columns are ``time_s``, ``<channel>_<unit>/<joint>`` such as ``joint_pos_rad/FR_hip``, and
optionally ``segment``, ``posture`` (an index of `motor_log.POSTURES`), ``base_roll_rad`` and
``base_pitch_rad``. The header is the schema metadata ``b"motorprior"``.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import atomic_path, parse_json
from motorprior.bounds import TABLE, TEXT, Field, exactly, many, one_of
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.log_reader import GIVE_COLUMNS, LogReader
from motorprior.logs.motor_log import (
    BASE_AXES,
    INTEGER_CHANNELS,
    JOINT_SERIES,
    SIGN_CONVENTION,
    MotorLog,
    checked,
    missing_column,
)
from motorprior.logs.readers.table import parquet_table
from motorprior.robots.motor_models import MotorModel, is_header_entry
from motorprior.robots.robot import Robot
from motorprior.schema import Schema

SCHEMA_VERSION = 4
METADATA_KEY = b"motorprior"
REWRITE = "write the log again with this version of motorprior"
_CHANNELS = (*JOINT_SERIES, *INTEGER_CHANNELS, "base_orientation")
_UNITS = {"time": "s", **JOINT_SERIES, "base_orientation": "rad"}
_TEXTS = ("robot", "motor", "source", "encoder", "gain_unit", "command_mode")
_HEADER = Schema(
    {
        "schema_version": exactly(SCHEMA_VERSION),
        "sign_convention": exactly(SIGN_CONVENTION),
        # a log of an older version lacks the units of newer channels
        "units": Field(
            "units of this version",
            lambda units: TABLE.accepts(units) and units.items() <= _UNITS.items(),
        ),
        "channels": many(one_of(*_CHANNELS), 2),
        **dict.fromkeys(("joint_names", "joint_classes"), many(TEXT)),
        **dict.fromkeys(_TEXTS, TEXT),
        "motor_models": many(Field("a motor model", is_header_entry)),
        "firmware": TABLE,
        "bodies": TEXT,
        "slow_commands": TABLE,
    },
    REWRITE,
    # a log of an older version has position commands
    optional=frozenset(
        {"firmware", "joint_classes", "motor_models", "command_mode", "bodies", "slow_commands"}
    ),
    name="header",
)


def write_log(path: str | Path, log: MotorLog) -> None:
    """Write a log to a .parquet file, atomically.

    Raises:
        LogError: as `checked`.
        ArtifactError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(path)
    log = checked(log, where=path)
    channels = [name for name in _CHANNELS if getattr(log, name) is not None]
    header: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "units": _UNITS,
        "sign_convention": SIGN_CONVENTION,
        "joint_names": list(log.joint_names),
        "channels": channels,
        **{name: getattr(log, name) for name in _TEXTS},
    }
    if log.firmware:
        header["firmware"] = dict(log.firmware)
    if log.given_classes:
        header["joint_classes"] = list(log.given_classes)
    if log.motor_models:
        header["motor_models"] = [model.as_json() for model in log.motor_models]
    if log.bodies:
        header["bodies"] = log.bodies
    if log.slow_commands:
        header["slow_commands"] = dict(log.slow_commands)

    columns: dict[str, np.ndarray] = {}
    for channel, names in _column_names(channels, log.joint_names).items():
        values = np.reshape(getattr(log, channel), (log.num_rows, len(names)))
        columns |= dict(zip(names, np.ascontiguousarray(values.T), strict=True))

    metadata = {METADATA_KEY: json.dumps(header, sort_keys=True).encode()}
    table = pa.table(columns).replace_schema_metadata(metadata)
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=2**20)


def read_parquet(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read the file of `write_log`, which states its robot; every float64 is restored bit for bit.

    Raises:
        LogError: another file, schema version, unit or sign convention, or a log that `checked`
            rejects.
    """
    path = Path(path)
    if path.suffix != ".parquet":
        raise LogError(
            f"a file {path.suffix}, not a motor log (.parquet)",
            where=path,
            remedy="convert a recording with `motorprior logs import`, or use mp.load_log in "
            "Python",
        )
    table = parquet_table(path)
    header = _header(table.schema.metadata or {}, path)

    values: dict[str, Any] = {key: header[key] for key in _TEXTS if key in header}
    values["firmware"] = header.get("firmware", {})
    values["given_classes"] = tuple(header.get("joint_classes", ()))
    values["motor_models"] = tuple(map(MotorModel.from_json, header.get("motor_models", ())))
    values["joint_names"] = tuple(header["joint_names"])
    values["bodies"] = header.get("bodies", "")
    values["slow_commands"] = header.get("slow_commands", {})
    for channel, names in _column_names(header["channels"], header["joint_names"]).items():
        for name in names:
            if name not in table.column_names:
                raise missing_column("column", name, table.column_names, path, REWRITE)
        columns = [table.column(name).to_numpy() for name in names]
        is_flat = channel in ("time", *INTEGER_CHANNELS)
        values[channel] = columns[0] if is_flat else np.stack(columns, axis=1)
    return checked(MotorLog(**values), where=path)


def _header(metadata: Mapping[bytes, bytes], path: Path) -> dict[str, Any]:
    text = metadata.get(METADATA_KEY)
    if text is None:
        raise LogError(
            "a Parquet file, but not a motor log: no motorprior header",
            where=path,
            remedy=f"import it {GIVE_COLUMNS}",
            argument="columns",
        )
    try:
        header = parse_json(text.decode())
        _HEADER.check(header, path)
    except (ValueError, ArtifactError) as error:
        raise LogError(f"bad header: {error}", where=path, remedy=REWRITE) from error
    return header


READER = LogReader("motor log", (".parquet",), read=read_parquet)


def _column_names(
    present: list[str], joint_names: list[str] | tuple[str, ...]
) -> dict[str, list[str]]:
    """Column names of ``time`` and of each channel present, in file order."""
    names = {"time": ["time_s"]}
    for channel in present:
        if channel in INTEGER_CHANNELS:
            names[channel] = [channel]
        elif channel == "base_orientation":
            names[channel] = [f"base_{axis}_rad" for axis in BASE_AXES]
        else:
            names[channel] = [f"{channel}_{JOINT_SERIES[channel]}/{joint}" for joint in joint_names]
    return names
