"""Recordings of a motor that swings a known pendulum, in the JSON of Rhoban/bam.

A file holds ``mass`` [kg] at ``length`` [m], ``kp`` (in firmware units), ``motor``, optionally
``vin``, the supply voltage [V], used where rows lack one, and ``entries`` with ``timestamp`` [s],
``goal_position`` and ``position`` [rad], 0 where the pendulum hangs down; optionally ``speed``
[rad/s], ``input_volts`` [V], ``temp`` [°C], ``torque_enable``. For a point mass and an optional arm
of ``arm_mass`` (a uniform rod),

    load_inertia    = (mass + arm_mass/3)·length²
    external_torque = -(mass + arm_mass/2)·g·length·sin(joint_pos)

and load_stiffness is the derivative of the latter. Rows with the torque off are dropped; a segment
ends there. The servos of these recordings measure and control the angle of their output shaft.
The makers of some state their stall torque (`known_motor`).
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_text
from motorprior.bounds import is_number
from motorprior.exceptions import LogError, quoted
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import NUMBER, OPERATING_CONDITIONS, MotorLog, bad_value, checked
from motorprior.robots.motor_models import known_motor
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.signals import runs_of_true

_REMEDY = "give a file of Rhoban/bam (mass, length, kp, motor, entries)"


def read_bam(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read one recording; raises LogError, also if the torque was never on."""
    try:
        content = json.loads(read_text(path, LogError))
        entries = content["entries"]
        enabled = np.array([bool(entry.get("torque_enable", True)) for entry in entries])
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError) as error:
        raise LogError(
            f"not JSON with a list of entries ({error})", where=path, remedy=_REMEDY
        ) from error

    mass = _positive(content, "mass", path)
    length = _positive(content, "length", path)
    kp = _positive(content, "kp", path)
    arm = _positive(content, "arm_mass", path) if content.get("arm_mass") else 0.0

    # where the torque is off, the goal may be null
    goals = [
        entry if on else entry | {"goal_position": 0.0}
        for entry, on in zip(entries, enabled, strict=True)
    ]
    angle = _column(entries, "position", path)
    measured = _operating_conditions(content)
    if any(entry.get("speed") is not None for entry in entries):
        measured["joint_vel"] = _column(entries, "speed", path)

    motor = str(content.get("motor", ""))
    model = known_motor(motor)
    log = MotorLog(
        time=_column(entries, "timestamp", path)[:, 0],
        position_target=_column(goals, "goal_position", path),
        joint_pos=angle,
        **measured,
        load_inertia=np.full_like(angle, (mass + arm / 3.0) * length**2),
        external_torque=-(mass + arm / 2.0) * GRAVITY * length * np.sin(angle),
        load_stiffness=-(mass + arm / 2.0) * GRAVITY * length * np.cos(angle),
        logged_kp=np.full_like(angle, kp),
        gain_unit="firmware",
        firmware={"output_encoder": 1.0},
        joint_names=("pendulum",),
        robot="pendulum",
        motor=motor,
        motor_models=(model,) if model else (),
        source=str(path),
    )
    return _with_torque_on(checked(log), enabled, path)


def _with_torque_on(log: MotorLog, enabled: np.ndarray, path: Path) -> MotorLog:
    """The runs of at least 2 rows with the torque on, a segment each."""
    runs = [run for run in runs_of_true(enabled).tolist() if run[1] - run[0] >= 2]
    if not runs:
        raise LogError("the torque is off in every row", where=path, remedy="record with torque")
    if enabled.all():
        return log

    rows = np.concatenate([np.arange(*run) for run in runs])
    segment = np.repeat(np.arange(len(runs)), [stop - start for start, stop in runs])
    source = f"{path} ({log.num_rows - len(rows)} rows without torque left out)"
    return checked(replace(log.rows(rows), segment=segment, source=source))


READER = LogReader("pendulum of Rhoban/bam", (".json", ".json.gz"), read=read_bam)


def _operating_conditions(content: dict[str, Any]) -> dict[str, Any]:
    """Voltage and temperature (T, 1), if all rows have them within their bounds.

    The recorder writes 0 for a failed read. The voltage of the file stands in for missing ones.
    """
    entries = content["entries"]
    values = {
        "supply_voltage": [entry.get("input_volts") for entry in entries],
        "motor_temperature": [entry.get("temp") for entry in entries],
    }
    if not _are_measured(values["supply_voltage"], "supply_voltage"):
        values["supply_voltage"] = [content.get("vin")] * len(entries)
    return {
        channel: np.array(column, dtype=np.float64)[:, None]
        for channel, column in values.items()
        if _are_measured(column, channel)
    }


def _are_measured(values: list[Any], channel: str) -> bool:
    low, high, _ = OPERATING_CONDITIONS[channel]
    return bool(values) and all(is_number(value, low, high) and value != 0 for value in values)


def _positive(content: dict[str, Any], name: str, path: Path) -> float:
    value: Any = content.get(name)
    if not is_number(value, 1e-12):
        raise LogError(
            f"{name} {quoted(value)} is not a positive number", where=path, remedy=_REMEDY
        )
    return float(value)


def _column(entries: list[dict[str, Any]], name: str, path: Path) -> np.ndarray:
    """(T, 1) numbers of all entries."""
    values = [entry.get(name) for entry in entries]
    for row, value in enumerate(values):
        if not is_number(value):
            raise bad_value(row, name, value, NUMBER, path, _REMEDY)
    return np.array(values, dtype=np.float64)[:, None]
