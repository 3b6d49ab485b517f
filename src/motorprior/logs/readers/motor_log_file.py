"""Motor logs on disk: one Parquet file per log, float64, with a strict JSON header.

Columns are ``time_s``, ``<channel>_<unit>/<joint>`` such as ``joint_pos_rad/FR_hip``, and
optionally ``segment``, ``posture`` (an index of `motor_log.POSTURES`), ``base_roll_rad`` and
``base_pitch_rad``. The header is the schema metadata ``b"motorprior"``.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import atomic_path, parse_json
from motorprior.bounds import TABLE, TEXT, Field, exactly, many, one_of
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.log_reader import GIVE_COLUMNS, LogReader
from motorprior.logs.motor_log import (
    BASE_AXES,
    CODES,
    JOINT_SERIES,
    SIGN_CONVENTION,
    MotorLog,
    checked,
    missing_column,
)
from motorprior.logs.readers.table import parquet_table
from motorprior.robots.robot import Robot
from motorprior.schema import Schema

SCHEMA_VERSION = 4
METADATA_KEY = b"motorprior"
REWRITE = "write the log again with this version of motorprior"
_CHANNELS = (*JOINT_SERIES, *CODES, "base_orientation")
_UNITS = {"time": "s", **JOINT_SERIES, "base_orientation": "rad"}
_TEXTS = ("robot", "motor", "source", "encoder", "gain_unit")
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
        "firmware": TABLE,
    },
    REWRITE,
    optional=frozenset({"firmware", "joint_classes"}),
    name="header",
)


def write_log(path: str | Path, log: MotorLog) -> None:
    """Write a log to a .parquet file, atomically; raises LogError as `checked`, ArtifactError if it cannot write."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path, log = Path(path), checked(log, where=path)
    header = {
        "schema_version": SCHEMA_VERSION,
        "units": _UNITS,
        "sign_convention": SIGN_CONVENTION,
        "joint_names": list(log.joint_names),
        "channels": [name for name in _CHANNELS if getattr(log, name) is not None],
        **{name: getattr(log, name) for name in _TEXTS},
        **({"firmware": dict(log.firmware)} if log.firmware else {}),
        **({"joint_classes": list(log.given_classes)} if log.given_classes else {}),
    }
    columns: dict[str, np.ndarray] = {}
    for channel, names in _column_names(header["channels"], log.joint_names).items():
        values = np.reshape(getattr(log, channel), (log.num_rows, len(names)))
        columns |= dict(zip(names, np.ascontiguousarray(values.T), strict=True))
    table = pa.table(columns).replace_schema_metadata(
        {METADATA_KEY: json.dumps(header, sort_keys=True).encode()}
    )
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=2**20)


def read_parquet(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read the file of `write_log`, which states its robot; every float64 is restored bit for bit.

    Raises LogError for another file, schema version, unit or sign convention, or a log that
    `checked` rejects.
    """
    path = Path(path)
    if path.suffix != ".parquet":
        remedy = "convert a recording with `motorprior logs import`, or use mp.load_log in Python"
        raise LogError(
            f"a file {path.suffix}, not a motor log (.parquet)", where=path, remedy=remedy
        )
    table = parquet_table(path)
    text = (table.schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        problem = "a Parquet file, but not a motor log: no motorprior header"
        remedy = f"import it {GIVE_COLUMNS}"
        raise LogError(problem, where=path, remedy=remedy, argument="columns")
    try:
        header = parse_json(text.decode())
        _HEADER.check(header, path)
    except (ValueError, ArtifactError) as error:
        raise LogError(f"bad header: {error}", where=path, remedy=REWRITE) from error
    values: dict[str, Any] = {key: header[key] for key in _TEXTS}
    values |= {
        "firmware": header.get("firmware", {}),
        "given_classes": tuple(header.get("joint_classes", ())),
    }
    for channel, names in _column_names(header["channels"], header["joint_names"]).items():
        if missing := [name for name in names if name not in table.column_names]:
            raise missing_column("column", missing[0], table.column_names, path, REWRITE)
        columns = [table.column(name).to_numpy() for name in names]
        values[channel] = columns[0] if channel in ("time", *CODES) else np.stack(columns, axis=1)
    return checked(MotorLog(joint_names=tuple(header["joint_names"]), **values), where=path)


READER = LogReader("motor log", (".parquet",), read=read_parquet)


def _column_names(
    present: list[str], joint_names: list[str] | tuple[str, ...]
) -> dict[str, list[str]]:
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
