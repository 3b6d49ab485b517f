"""Tables whose columns a `ColumnMap` names, CSV (plain or gzip) or Parquet, become `MotorLog`s.

Only the columns that the map names are read, batch by batch.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.column_map import JOINT, ColumnMap, MappedJoint
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.robots.robot import Robot

ENDINGS = (".csv", ".csv.gz", ".parquet")
MAX_ROWS = 50_000_000
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")
_REMEDY = "correct the column map, or the file"


def read_mapped_log(path: str | Path, columns: ColumnMap, robot: Robot | None = None) -> MotorLog:
    """Read a table.

    Args:
        path: .csv, .csv.gz or .parquet; its first line or its schema names the columns.
        columns: what they mean.
        robot: whose joints these are, in whose order the log will have them; the map's own names and order without.

    Raises:
        LogError: missing or damaged file, a column that it lacks, a cell that is not a finite number, joints that are
            not the robot's; names the file, the column and the value.
    """
    path = Path(path)
    joints = _in_order(columns, robot, path)
    wanted = {name: [text.replace(JOINT, joint.column) for joint in joints] for name, text in columns.series.items()}
    singles = [columns.time, *([columns.segment] if columns.segment else [])]
    found = _read(path, [*singles, *(name for names in wanted.values() for name in names)])
    values: dict[str, Any] = {"time": columns.scales["time"] * found[columns.time]}
    for channel, names in wanted.items():
        values[channel] = _channel(channel, np.stack([found[name] for name in names], axis=1), joints, columns)
    for channel, gains in columns.gains(joints).items():
        values[channel] = np.broadcast_to(gains, (len(values["time"]), len(joints)))
    if columns.segment:
        values["segment"] = _whole(found[columns.segment], columns.segment, path)
    return checked(
        MotorLog(
            joint_names=tuple(joint.name for joint in joints), robot=robot.name if robot else columns.robot,
            motor=columns.motor, source=str(path), encoder=columns.encoder,
            gain_unit=columns.gain_unit, **values,
        ),
        where=path,
    )  # fmt: skip


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    if strange := sorted(by_name.keys() - set(robot.joint_names)):
        raise LogError(
            f"the column map {columns.source} has a joint {strange[0]!r}, robot {robot.name} has none of that name",
            where=path, remedy=f"give its key name one of {', '.join(robot.joint_names)}",
        )  # fmt: skip
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)


def _channel(channel: str, raw: np.ndarray, joints: tuple[MappedJoint, ...], columns: ColumnMap) -> np.ndarray:
    sign, zero = (np.array([getattr(joint, name) for joint in joints]) for name in ("sign", "zero"))
    if channel == "load_inertia":
        return raw
    values = sign * columns.scales[channel] * raw
    return values + zero if channel in ("position_target", "joint_pos") else values


def _whole(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    odd = np.flatnonzero(values != np.rint(values))
    if odd.size:
        raise LogError(
            f"row {odd[0]}, {name} is {values[odd[0]]:g}, not a whole number", where=path, remedy=_REMEDY
        )  # fmt: skip
    return values.astype(np.int64)


def _read(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """Each named column (T,), float64."""
    import pyarrow as pa

    if not path.is_file():
        raise LogError("no such file", where=path, remedy="check the path")
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
    rows = 0
    try:
        for batch in _batches(path, names):
            for name in names:
                parts[name].append(_numbers(batch, name, rows, path))
            rows += batch.num_rows
            if rows > MAX_ROWS:
                raise LogError(f"more than {MAX_ROWS} rows", where=path, remedy="split the recording")
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise LogError(
            f"cannot be read ({str(error).splitlines()[0][:300]})", where=path, remedy="copy or record it again"
        ) from error
    if not rows:
        raise LogError("no rows", where=path, remedy="copy or record it again")
    return {name: np.concatenate(values) for name, values in parts.items()}


def _batches(path: Path, names: list[str]) -> Iterator[Any]:
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pq

    if path.suffix == ".parquet":
        file = pq.ParquetFile(path)
        yield from file.iter_batches(columns=_present(file.schema_arrow.names, names, path))
        return
    with pa.input_stream(str(path), compression="gzip" if path.suffix == ".gz" else None) as stream:
        header = pa_csv.open_csv(stream)
        wanted = _present(header.schema.names, names, path)
    with pa.input_stream(str(path), compression="gzip" if path.suffix == ".gz" else None) as stream:
        options = pa_csv.ConvertOptions(include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64()))
        yield from pa_csv.open_csv(stream, convert_options=options)


def _present(have: list[str], names: list[str], path: Path) -> list[str]:
    """Columns of the file that hold these names, each once."""
    found = dict.fromkeys(_owner(name, have) for name in names)
    for name in found:
        if have.count(name) != 1:
            problem = "no column" if name not in have else "more than one column"
            shown = ", ".join(have[:8]) + (", …" if len(have) > 8 else "")
            raise LogError(f"{problem} {name[:80]!r}; it has {shown[:300]}", where=path, remedy=_REMEDY)
    return list(found)


def _owner(name: str, have: list[str]) -> str:
    """The column that holds a name: that of this name, or the column of lists of which it is an element."""
    element = _ELEMENT.fullmatch(name)
    return element[1] if element and name not in have else name


def _numbers(batch: Any, name: str, before: int, path: Path) -> np.ndarray:
    """(rows,) float64 of a batch."""
    owner = _owner(name, batch.schema.names)
    column = batch.column(owner)
    if owner != name:
        column = _element(column, name, path)
    kind = str(column.type)
    if column.null_count or not (kind in ("float", "double", "halffloat") or kind.startswith(("int", "uint"))):
        empty = np.flatnonzero(~np.asarray(column.is_valid()))
        problem = f"row {before + empty[0]}, {name} is empty" if empty.size else f"{name} is {kind}, not numbers"
        raise LogError(problem, where=path, remedy=_REMEDY)
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _element(column: Any, name: str, path: Path) -> Any:
    import pyarrow as pa
    import pyarrow.compute as pc

    index = int(_ELEMENT.fullmatch(name)[2])  # pyright: ignore[reportOptionalSubscript]
    if "list" not in str(column.type):
        raise LogError(f"{name}: the column is {column.type}, not lists", where=path, remedy=_REMEDY)
    try:
        return pc.list_element(column, index)  # pyright: ignore[reportAttributeAccessIssue]
    except pa.ArrowException as error:
        raise LogError(f"{name}: a list has no such element ({error})", where=path, remedy=_REMEDY) from error
