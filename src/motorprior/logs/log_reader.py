"""The interface of a log format, and logs from the columns that a `ColumnMap` names."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from motorprior.exceptions import ConfigError, LogError, listed
from motorprior.logs.column_map import (
    BASE_ANGLES,
    GAINS,
    TURN,
    ColumnMap,
    Conversion,
    MappedJoint,
)
from motorprior.logs.motor_log import (
    CORRECT,
    POSTURES,
    MotorLog,
    bad_value,
    checked,
    require_finite,
)
from motorprior.robots.robot import Robot

IN_MAP = "in the column map"
MAX_NORM_ERROR = 0.02  # maximum deviation of the norm of a quaternion from 1
MAX_REPEATED_TIMES = 1e-3  # maximum share of rows that are left out as they repeat a time
FOLDER = "/"  # the ending of a folder's name
GIVE_COLUMNS = "with columns, the file of a column map (docs/your-motors.md)"
# reads named columns of a path, each (rows,) float64, or timedelta64 for time stamps
Columns: TypeAlias = Callable[[Path, list[str], ColumnMap], dict[str, np.ndarray]]


@dataclass(frozen=True)
class LogReader:
    """A log format; the READER of a module in `logs.readers`."""

    name: str  # name in messages
    endings: tuple[str, ...]  # endings of its file names with the dot, or FOLDER
    # whether a path with such an ending has this format
    recognises: Callable[[Path], bool] = lambda path: True
    # None if the format needs a column map
    read: Callable[[Path, Robot | None], MotorLog] | None = None
    columns: Columns | None = None  # for a column map; None if it needs none
    # names of the columns or arrays of a file that is read with a column map
    names: Callable[[Path], Sequence[str]] = lambda path: ()
    # text about the content, for the error if a format that needs a map is read without
    unmapped: Callable[[Path], str] = lambda path: ""
    # (path, robot, period [s], suspended) -> the log on a grid, for a format that has more
    # information than its rows
    on_grid: Callable[[Path, Robot | None, float, bool], MotorLog] | None = None
    needs_robot: bool = False  # whether it needs a robot, since it does not name its joints
    # a sentence for the user about what is assumed because the format lacks it
    assumption: str = ""

    def matches(self, path: Path) -> bool:
        """Whether an existing path has this format; raises `LogError` if it cannot be read."""
        name = path.name + FOLDER if path.is_dir() else path.name
        return name.endswith(self.endings) and self.recognises(path)


def require_robot(robot: Robot | None, path: Path) -> Robot:
    """The robot of a format that does not name its joints; raises ConfigError if none was given."""
    if robot is None:
        raise ConfigError(
            "the log does not name its joints", where=path, remedy="give robot", argument="robot"
        )
    return robot


def read_mapped_log(
    path: Path, columns: ColumnMap, source: Columns, robot: Robot | None = None
) -> MotorLog:
    """The log of the columns of a path that ``source`` reads.

    A robot gives the order of the joints, and the place of the encoder unless the map does.

    Raises:
        LogError: as ``source``; a cell that is not finite, or a joint that the robot does not have.
    """
    joints = _in_order(columns, robot, path)
    series = {channel: columns.columns_of(channel, joints) for channel in columns.series}
    table = source(path, _column_names(columns, series), columns)
    origin = str(path)
    if columns.time:
        table, num_duplicates = _without_duplicates(table, columns)
        if num_duplicates:
            origin = f"{path} (duplicate rows left out: {num_duplicates})"

    shape = (len(next(iter(table.values()))), len(joints))
    values: dict[str, Any] = {"time": _time(table, columns, shape[0], path)}
    for channel, names in series.items():
        values[channel] = _converted(table, channel, names, joints, path)
        if channel in GAINS:
            values[channel] *= columns.gain_scale
    _match_turns(values, joints)
    _set_commands(values, joints, path)

    for name, value in columns.operating_conditions.items():
        values[name] = np.full(shape, value)
    orientation = _base_orientation(table, columns, shape[0], path)
    if orientation is not None:
        values["base_orientation"] = orientation
    if columns.segment:
        values["segment"] = _integers(table[columns.segment], columns.segment, path)
    if columns.posture:
        values["posture"] = np.full(shape[0], POSTURES.index(columns.posture))

    log = MotorLog(
        joint_names=tuple(joint.name for joint in joints),
        robot=robot.name if robot else columns.robot,
        motor=columns.motor,
        source=origin,
        encoder=columns.encoder or (robot.encoder if robot else "joint"),
        gain_unit=columns.gain_unit,
        firmware=columns.firmware,
        **values,
    )
    return checked(log)


def _set_commands(values: dict[str, Any], joints: tuple[MappedJoint, ...], path: Path) -> None:
    """Replace kp and kd by logged gains, and set the command mode and missing commands.

    Gains of the file's columns count more than the numbers of the map. Gains of 0 in every row
    stand for velocity or torque commands, and are left out. So are velocity targets and torques
    that are 0 in every row. kd without a velocity target acts against the velocity.
    """
    angle = values["joint_pos"]
    for name in GAINS:
        gains = values.pop(name, None)
        numbers = [getattr(joint, name) for joint in joints]
        if gains is None and None not in numbers:
            gains = np.broadcast_to(numbers, angle.shape)
        if gains is not None:
            values[f"logged_{name}"] = gains

    # a target has no effect while its gain is 0, and some firmware then gets a huge number
    kp = values.get("logged_kp")
    kd = values.get("logged_kd")
    if kp is not None and "position_target" in values:
        values["position_target"] = np.where(kp == 0.0, angle, values["position_target"])
    if kd is not None and "velocity_target" in values:
        values["velocity_target"] = np.where(kd == 0.0, 0.0, values["velocity_target"])

    uses_kp = kp is None or bool(np.any(kp))
    if "position_target" in values and uses_kp:
        for name in ("velocity_target", "torque_feedforward"):
            if name in values and not np.any(values[name]):
                del values[name]  # it was never used
        is_position = "velocity_target" not in values and "torque_feedforward" not in values
        values["command_mode"] = "position" if is_position else "mit"
        return
    if kp is not None and uses_kp:
        raise LogError(
            f"kp is {kp.max():.4g}, and no angle is commanded",
            where=path,
            remedy="give the column of the commanded angle as position_target, or leave kp out",
        )

    uses_kd = kd is not None and bool(np.any(kd))
    if kd is None:
        uses_kd = "velocity_target" in values
    if not uses_kd and "torque_feedforward" not in values:
        raise LogError(
            "kp and kd are 0 in every row, and no torque is commanded",
            where=path,
            remedy="give the column of the commanded torque as torque_feedforward",
        )
    values["position_target"] = angle
    values.pop("logged_kp", None)
    if uses_kd:
        values["command_mode"] = "velocity"
        # a drive with kd and without a velocity target brakes to rest
        values.setdefault("velocity_target", np.zeros_like(angle))
    else:
        values["command_mode"] = "torque"
        values.pop("velocity_target", None)
        values.pop("logged_kd", None)


def gain_contradictions(log: MotorLog, columns: ColumnMap) -> tuple[str, ...]:
    """Warnings of gains of the file's columns that differ from the numbers of the map by > 1 %."""
    warnings = []
    for name in GAINS:
        gains = getattr(log, f"logged_{name}")
        if name not in columns.series or gains is None:
            continue
        largest = dict(zip(log.joint_names, gains.max(axis=0).tolist(), strict=True))
        for joint in columns.joints:
            number = getattr(joint, name)
            logged = largest.get(joint.name)
            if number is None or logged is None or abs(logged - number) <= 0.01 * abs(number):
                continue
            warnings.append(
                f"{name} of {joint.name} is {logged:.4g} in the file (largest) and {number:.4g} in "
                f"the column map {columns.source}; the file counts -> correct the map"
            )
    return tuple(warnings)


def unmapped_gains(names: Sequence[str], columns: ColumnMap) -> tuple[str, ...]:
    """Warnings of gains among the ``names`` of a file's columns that the map does not use."""
    warnings = []
    for name in GAINS:
        is_gain = re.compile(rf"(?<![a-z]){name}(?![a-z])", re.IGNORECASE)
        unmapped = [column for column in names if is_gain.search(column)]
        if name not in columns.series and unmapped:
            warnings.append(
                f"the column map {columns.source} ignores gains of the file: {listed(unmapped, 5)} "
                f"-> name them in the map by {name} = ..."
            )
    return tuple(warnings)


def _base_orientation(
    table: dict[str, np.ndarray], columns: ColumnMap, num_rows: int, path: Path
) -> np.ndarray | None:
    """(T, 2) roll and pitch [rad]; None if the map does not state them."""
    if columns.base_angles is not None:
        return np.tile(columns.base_angles, (num_rows, 1))
    if not columns.base_orientation:
        return None
    values = np.stack([table[name] for name in columns.base_orientation], axis=1)
    require_finite(values, list(columns.base_orientation), path)
    if len(columns.base_orientation) == len(BASE_ANGLES):
        return columns.base_angle_scale * values

    norms = np.linalg.norm(values, axis=1)
    is_off = np.abs(norms - 1.0) > MAX_NORM_ERROR
    if is_off.any():
        row = int(is_off.argmax())
        names = ", ".join(columns.base_orientation)
        raise bad_value(row, f"norm of {names}", norms[row], "1", path, CORRECT)
    from motorprior.rotations import roll_pitch_yaw  # it compiles

    quaternions = np.ascontiguousarray(values / norms[:, None])
    return np.array([roll_pitch_yaw(quaternion)[:2] for quaternion in quaternions])


def _column_names(columns: ColumnMap, series: dict[str, list[str]]) -> list[str]:
    """Each column that the log needs, once."""
    times = (columns.time, columns.subseconds, columns.segment)
    names = [name for name in times if name]
    names += columns.base_orientation
    names += chain(*series.values())
    return list(dict.fromkeys(names))


def _without_duplicates(
    table: dict[str, np.ndarray], columns: ColumnMap
) -> tuple[dict[str, np.ndarray], int]:
    """The table without rows that repeat the previous row, and the number of these rows.

    Rows that only repeat its time are left out as well, if they are few.
    """

    def repeats(names: Iterable[str]) -> np.ndarray:
        equal = [table[name][1:] == table[name][:-1] for name in names]
        return np.append(False, np.all(equal, axis=0))

    times = [name for name in (columns.time, columns.subseconds) if name]
    same_time = repeats(times)
    duplicate = same_time if same_time.mean() <= MAX_REPEATED_TIMES else repeats(table)
    if not duplicate.any():
        return table, 0
    return {name: values[~duplicate] for name, values in table.items()}, int(duplicate.sum())


def _time(
    table: dict[str, np.ndarray], columns: ColumnMap, num_rows: int, path: Path
) -> np.ndarray:
    """(T,) [s]."""
    if columns.rate is not None:
        return np.arange(num_rows) / columns.rate
    time = table[columns.time or ""]
    if time.dtype.kind == "m":
        return time / np.timedelta64(1, "s")
    require_finite(time[:, None], [f"time (column {columns.time})"], path)
    if columns.subseconds is not None:
        subseconds = table[columns.subseconds]
        require_finite(subseconds[:, None], [f"time (column {columns.subseconds})"], path)
        _require_subsecond_unit(time, subseconds, columns, path)
        # relative to the first row, since a float64 resolves 0.2 µs of the seconds since 1970
        return (time - time[0]) + columns.subsecond_scale * subseconds
    if columns.time_bits is not None:
        # a smaller fall is no restart: two rows are exchanged
        falls = np.diff(time, prepend=time[0]) < -0.5 * 2.0**columns.time_bits
        time = time - time[0] + np.cumsum(falls) * 2.0**columns.time_bits
    elif columns.segment is None:
        _require_clock(time, columns, path)
    return columns.time_scale * time


def _require_subsecond_unit(
    time: np.ndarray, subseconds: np.ndarray, columns: ColumnMap, path: Path
) -> None:
    """Raise LogError for nanoseconds that stay below a millisecond while seconds pass."""
    largest = float(subseconds.max())
    num_seconds = len(np.unique(time))
    if columns.subsecond_scale != 1e-9 or largest >= 1e6 or len(time) < 4 * num_seconds:
        return
    if num_seconds < 2:
        return
    unit = "us" if largest >= 1e3 else "ms"
    unit = "s" if largest <= 1.0 else unit
    raise LogError(
        f"time (column {columns.subseconds}) is at most {largest:.6g} in {num_seconds} seconds: "
        "these are no nanoseconds",
        where=path,
        remedy=f'state time = "{unit}" in [units] {IN_MAP}',
    )


COUNTER_BITS = (16, 24, 32)  # of the counters of microcontrollers
_PAIR = 'time = ["SECONDS", "NANOSECONDS"], the columns of both'
_MONOTONIC = "record a monotonic clock"


def _require_clock(time: np.ndarray, columns: ColumnMap, path: Path) -> None:
    """Raise LogError with its cause, unless the column ``time`` (T,) increases, in its own unit."""
    steps = np.diff(time)
    if not np.any(steps <= 0.0):
        return
    row = 1 + int(np.argmax(steps <= 0.0))
    problem, remedy = _fault_of_clock(time, columns.time_scale)
    name = f"time (column {columns.time})"
    raise LogError(f"row {row}, {name}: {problem}", where=path, remedy=f"{remedy} {IN_MAP}")


def _fault_of_clock(time: np.ndarray, scale: float) -> tuple[str, str]:
    """Cause and remedy of times (T,), in their own unit of ``scale`` [s], that do not increase."""
    steps = np.diff(time)
    largest_fall = -float(steps.min())
    if time.min() >= 0.0 and time.max() < 1e9 and largest_fall > 0.9e9:
        return "nanoseconds of a stamp, without its seconds", f"give {_PAIR},"
    for bits in COUNTER_BITS:
        if time.min() >= 0.0 and time.max() < 2.0**bits and largest_fall > 0.5 * 2.0**bits:
            return f"the counter restarts at 2^{bits}", f"state time_bits = {bits}"

    resolution = float(np.spacing(np.float32(np.abs(time).max())))
    if np.array_equal(time.astype(np.float32), time) and resolution * scale > 1e-4:
        problem = f"it has a resolution of {resolution * scale:.3g} s (float32, or few digits)"
        return problem, "write it as float64 with all digits; or state rate, in place of time,"
    if largest_fall > 0.0:
        problem = f"the clock was set back by {largest_fall * scale:.3g} s"
        remedy = f"{_MONOTONIC}; or give a column that begins a segment there as segment"
        return problem, remedy
    if scale == 1.0 and np.array_equal(np.rint(time), time):
        return "whole seconds", f"give {_PAIR},"
    resolution = float(steps[steps > 0.0].min()) * scale if np.any(steps > 0.0) else 0.0
    problem = f"it repeats; the clock resolves {1e3 * resolution:.3g} ms"
    return problem, f"{_MONOTONIC}; or state rate, in place of time,"


def _converted(
    table: dict[str, np.ndarray],
    channel: str,
    names: list[str],
    joints: tuple[MappedJoint, ...],
    path: Path,
) -> np.ndarray:
    """(T, J) values of a channel in SI units, unwrapped."""
    columns = np.stack([table[name] for name in names], axis=1)
    labels = [
        f"{channel}/{joint.name} (column {name})" for joint, name in zip(joints, names, strict=True)
    ]
    require_finite(columns, labels, path)

    conversions = [joint.conversions.get(channel, Conversion()) for joint in joints]
    factors = np.array([conversion.factor for conversion in conversions])
    offsets = np.array([conversion.offset for conversion in conversions])
    values = factors * columns + offsets

    wraps = np.array([conversion.wraps for conversion in conversions])
    values[:, wraps] = np.unwrap(values[:, wraps], period=TURN, axis=0)
    return values


def _match_turns(values: dict[str, np.ndarray], joints: tuple[MappedJoint, ...]) -> None:
    """Put unwrapped angles into the turn of their command."""
    if "position_target" not in values:
        return
    for index, joint in enumerate(joints):
        if joint.conversions.get("joint_pos", Conversion()).wraps:
            angle = values["joint_pos"][:, index]
            turns = np.rint(np.median(values["position_target"][:, index] - angle) / TURN)
            values["joint_pos"][:, index] += TURN * turns


def _integers(column: np.ndarray, name: str, path: Path) -> np.ndarray:
    is_integer = column == np.rint(column)
    if not np.all(is_integer):
        row = int(np.argmin(is_integer))
        raise bad_value(row, name, column[row], "an integer", path, CORRECT)
    return column.astype(np.int64)


def robot_of_joints(robot: Robot | None, joint_names: tuple[str, ...]) -> Robot | None:
    """The robot if it has all these joints, else None.

    A log that names its joints may be of another robot.
    """
    if robot is None or not set(joint_names) <= set(robot.joint_names):
        return None
    return robot


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    """The joints of the map, in the order of the robot."""
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    unknown = sorted(by_name.keys() - set(robot.joint_names))
    if unknown:
        raise LogError(
            f"the column map {columns.source} has a joint {unknown[0]!r}, robot {robot.name} has "
            "none such",
            where=path,
            remedy=f"remove its table, or give its key name one of {', '.join(robot.joint_names)}",
        )
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)
