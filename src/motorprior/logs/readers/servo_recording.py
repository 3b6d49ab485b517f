"""Recordings of servos on a bus by `motorprior record`: a header of all that is known, then rows.

The first line is HEADING and a JSON object, the second the column names; every reading of the bus
is a line. The last line may be cut if the writer was killed; it is then ignored. A row holds the
sensors of all servos and the target in force, which was written at ``target_since``; its time is
the middle of the reading. No column map is needed.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_text
from motorprior.bounds import TABLE, TEXT, exactly, many, number, one_of
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import (
    MIN_ROWS,
    POSTURES,
    MotorLog,
    checked,
    require_finite,
    require_increasing,
)
from motorprior.logs.operations import GAP_FACTOR, resample, smooth_on_grid
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.robots.motor_models import known_motor
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.schema import Schema
from motorprior.signals import mean_command

HEADING = "# motorprior servo recording "
ENDING = ".servolog"
VERSION = 1
_REMEDY = "record again with this version of motorprior"
_CLOCKS = ("time", "mode", "part", "read_begin", "read_end", "target_since")
_SERIES = (
    "position_target",
    "joint_pos",
    "joint_vel",
    "load",
    "current",
    "supply_voltage",
    "motor_temperature",
)
_HEADER = Schema(
    {
        "version": exactly(VERSION),
        "robot": TEXT,
        "motor": TEXT,
        "posture": one_of(*POSTURES),
        "encoder": one_of("joint", "rotor"),
        "joint_names": many(TEXT),
        "joint_classes": many(TEXT),
        "p_gains": many(number(0.0, 1e9)),
        "firmware": TABLE,
        "pendulum": TABLE,
        "units": TABLE,
        "servos": many(TABLE),
        "settings": TABLE,
    },
    _REMEDY,
    optional=frozenset({"pendulum"}),
    name="header",
)


def servo_columns(joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Column names: times [s], activity, index of the part, and series per joint.

    Series are in rad, rad/s, V and °C; units of load and current are in the header.
    """
    return (*_CLOCKS, *(f"{name}/{joint}" for name in _SERIES for joint in joint_names))


def read_servo_recording(path: Path, period: float | None = None, smooth: bool = False) -> MotorLog:
    """Read the excited parts of a recording, a segment each.

    With a ``period`` [s], segments are on this grid: the command of a row is the mean of the
    targets in force during its period, at their times of writing. ``smooth`` then smooths the
    angles, as loads by a robot's model need. A recording of a pendulum has its load,

        load_inertia    = (mass + bar_mass/3)·length²
        external_torque = -(mass + bar_mass/2)·g·length·sin(joint_pos)

    where angle 0 hangs down.

    Raises:
        LogError: another or damaged file, or no excited row.
    """
    header, table = _read(path)
    names = tuple(header["joint_names"])
    log, since = _excited(header, names, table, path)
    if period is not None:
        log = _on_grid(log, since, period, smooth)

    pendulum = header.get("pendulum")
    if pendulum:
        log = _with_pendulum(log, **pendulum)
    return checked(log)


def _read(path: Path) -> tuple[dict[str, Any], np.ndarray]:
    """The header, and the rows of the table."""
    first, _, rest = read_text(path, LogError).partition("\n")
    if not first.startswith(HEADING):
        raise LogError("not a recording of servos", where=path, remedy=_REMEDY)
    try:
        header = json.loads(first.removeprefix(HEADING))
        _HEADER.check(header, path)
    except (ValueError, ArtifactError) as error:
        raise LogError(f"bad header: {error}", where=path, remedy=_REMEDY) from error

    lines = rest.split("\n")
    columns = servo_columns(tuple(header["joint_names"]))
    if tuple(lines[0].split(",")) != columns:
        raise LogError("its columns are not those of its joints", where=path, remedy=_REMEDY)
    rows = []
    for row, line in enumerate(lines[1:-1]):  # the last line is empty or cut
        values = line.split(",")
        try:
            numbers = [float(value) for value in values]
        except ValueError:
            numbers = []
        if len(numbers) != len(columns):
            raise LogError(
                f"row {row} has not {len(columns)} numbers",
                where=path,
                remedy="copy or record it again",
            )
        rows.append(numbers)
    if not rows:
        raise LogError("no rows", where=path, remedy=_REMEDY)
    table = np.array(rows)
    require_finite(table, list(columns), path)
    require_increasing(table[:, 0], path)
    return header, table


def _excited(
    header: dict[str, Any], names: tuple[str, ...], table: np.ndarray, path: Path
) -> tuple[MotorLog, np.ndarray]:
    """The log of the excited rows as recorded, and the times of writing (T,) of their targets."""
    table = table[table[:, 1] == Mode.EXCITE]
    steps = np.diff(table[:, 0], prepend=-np.inf)
    begins = np.diff(table[:, 2], prepend=-1.0) != 0.0
    begins |= steps > GAP_FACTOR * np.median(steps)
    segment = np.cumsum(begins) - 1
    is_long = np.bincount(segment, minlength=1)[segment] >= MIN_ROWS
    if not is_long.any():
        raise LogError("no excited row", where=path, remedy="record for longer")

    table = table[is_long]
    _, segment = np.unique(segment[is_long], return_inverse=True)
    columns = np.split(table[:, len(_CLOCKS) :], len(_SERIES), axis=1)
    series = dict(zip(_SERIES, columns, strict=True))
    gains = np.array(header["p_gains"])
    # motors of a robot may have gears behind them, which only the robot's file states
    model = known_motor(header["motor"]) if header.get("pendulum") else None
    log = MotorLog(
        time=table[:, 0],
        position_target=series["position_target"],
        joint_pos=series["joint_pos"],
        joint_vel=series["joint_vel"],
        supply_voltage=series["supply_voltage"],
        motor_temperature=series["motor_temperature"],
        logged_kp=np.tile(gains, (len(table), 1)),
        gain_unit="firmware",
        firmware=header["firmware"],
        posture=np.full(len(table), POSTURES.index(header["posture"])),
        segment=segment,
        joint_names=names,
        given_classes=tuple(header["joint_classes"]),
        robot=header["robot"],
        motor=header["motor"],
        motor_models=(model,) if model else (),
        source=str(path),
        encoder=header["encoder"],
    )
    return checked(log), table[:, 5]


def _on_grid(log: MotorLog, since: np.ndarray, period: float, smooth: bool) -> MotorLog:
    grid = smooth_on_grid(log, period) if smooth else resample(log, period)

    targets = []
    for recorded, gridded in zip(log.segment_slices(), grid.segment_slices(), strict=True):
        written = np.maximum.accumulate(since[recorded])
        written[0] = min(written[0], log.time[recorded.start])
        target = log.position_target[recorded]
        targets.append(mean_command(written, target, grid.time[gridded], period))
    return replace(grid, position_target=np.concatenate(targets))


def _with_pendulum(log: MotorLog, length: float, mass: float, bar_mass: float) -> MotorLog:
    gravity = (mass + 0.5 * bar_mass) * GRAVITY * length
    return replace(
        log,
        load_inertia=np.full_like(log.joint_pos, (mass + bar_mass / 3.0) * length**2),
        external_torque=-gravity * np.sin(log.joint_pos),
        load_stiffness=-gravity * np.cos(log.joint_pos),
    )


def _read_rows(path: Path, robot: Robot | None) -> MotorLog:
    return read_servo_recording(path)


def _read_on_grid(path: Path, robot: Robot | None, period: float, suspended: bool) -> MotorLog:
    header, _ = _read(path)
    # loads by a robot's model need smooth angles
    return read_servo_recording(path, period, smooth=robot is not None and "pendulum" not in header)


READER = LogReader("recording of servos", (ENDING,), read=_read_rows, on_grid=_read_on_grid)
