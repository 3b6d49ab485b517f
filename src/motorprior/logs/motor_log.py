"""`MotorLog`: commands and measured motion of motors in SI units; its checks and common errors."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from motorprior.bounds import first_not_finite, is_number
from motorprior.exceptions import ConfigError, LogError, listed, quoted
from motorprior.logs.command_modes import COMMAND_MODES, check_command_mode, gains_change
from motorprior.robots.joint_classes import motor_classes
from motorprior.robots.motor_models import MotorModel
from motorprior.signals import rms
from motorprior.texts import Overview, Printable

# channels of shape (T, J), and their units as written in column names
JOINT_SERIES = {
    "position_target": "rad",
    "velocity_target": "rad_per_s",
    "torque_feedforward": "N_m",
    "joint_pos": "rad",
    "joint_reading": "rad",
    "joint_vel": "rad_per_s",
    "joint_torque": "N_m",
    "load_inertia": "kg_m2",
    "external_torque": "N_m",
    "load_stiffness": "N_m_per_rad",
    "logged_kp": "gain_unit",
    "logged_kd": "gain_unit",
    "supply_voltage": "V",
    "motor_temperature": "degC",
}
INTEGER_CHANNELS = ("segment", "posture")  # integer channels of shape (T,)
BASE_AXES = ("roll", "pitch")
MIN_ROWS = 4  # minimum length of a segment next to a gap, or of a robot's recording
ENCODERS = ("joint", "rotor")
PHYSICAL_GAINS = "N·m/rad"
GAIN_UNITS = (PHYSICAL_GAINS, "firmware")


class Range(NamedTuple):
    """Values that a setting of a log may have."""

    low: float
    high: float
    unit: str


# registers of the profile and the dead zone (0: off), and the encoder of the control law: 1 on the
# output shaft, 0 on the rotor
FIRMWARE = {
    "profile_speed": Range(1e-3, 1e6, "rad/s"),
    "profile_acceleration": Range(1e-3, 1e9, "rad/s²"),
    "dead_zone": Range(1e-6, 1.0, "rad"),
    "output_encoder": Range(1.0, 1.0, "1"),
}
OPERATING_CONDITIONS = {
    "supply_voltage": Range(0.1, 2000.0, "V"),
    "motor_temperature": Range(-60.0, 300.0, "°C"),
}
# the channel `posture` holds indices of this tuple
POSTURES = ("standing", "suspended", "fixed", "fallen")
SIGN_CONVENTION = (
    "position error = position_target - joint_pos; "
    "a positive joint_torque accelerates joint_pos upwards; "
    "load_inertia * joint_acc = joint_torque + external_torque"
)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotorLog(Printable):
    """One or more contiguous recordings (segments) of T rows and J joints.

    Construction does not check; `checked` does. A row holds the measurements at its time and the
    command in force. With a known load, load_inertia·q̈ = joint_torque + external_torque. Models
    read gains, registers and operating conditions of a segment, or of the whole log, from `gains`,
    `firmware` and `operating_conditions`.
    """

    time: np.ndarray  # (T,) [s], strictly increasing within a segment
    # (T, J) commanded angle [rad]; joint_pos for velocity and torque commands
    position_target: np.ndarray
    joint_pos: np.ndarray  # (T, J) measured angle [rad]
    joint_names: tuple[str, ...]  # J names, in column order
    robot: str  # name of the robot or bench
    motor: str  # motor model
    source: str  # file of the recording
    command_mode: str = "position"  # one of COMMAND_MODES
    velocity_target: np.ndarray | None = None  # (T, J) commanded velocity [rad/s]
    torque_feedforward: np.ndarray | None = None  # (T, J) commanded torque [N·m]
    joint_vel: np.ndarray | None = None  # (T, J) [rad/s]
    # (T, J) angle as it was read, where joint_pos is smoothed [rad]
    joint_reading: np.ndarray | None = None
    joint_torque: np.ndarray | None = None  # (T, J) torque of the motor on the joint [N·m]
    # (T, J) inertia of the load about the joint, without the motor's rotor [kg·m²]
    load_inertia: np.ndarray | None = None
    # (T, J) torque on the joint by everything except the motor [N·m]
    external_torque: np.ndarray | None = None
    # (T, J) derivative of external_torque with respect to the joint's angle, at the recorded angle
    # [N·m/rad]. A simulated joint gets external_torque + load_stiffness·(simulated angle -
    # joint_pos).
    load_stiffness: np.ndarray | None = None
    # (T,) index of the contiguous recording; None for a single one
    segment: np.ndarray | None = None
    base_orientation: np.ndarray | None = None  # (T, 2) roll and pitch of the base [rad]
    posture: np.ndarray | None = None  # (T,) how the base was supported, an index of POSTURES
    # "joint" encoder, or "rotor": without backlash and elasticity of the gear; angles are at the
    # output shaft in both
    encoder: str = "joint"
    # (T, J) logged proportional gain in force; none in velocity and torque mode
    logged_kp: np.ndarray | None = None
    # (T, J) logged derivative gain in force, acting on the velocity; without logged_kp in velocity
    # mode only, none in torque mode
    logged_kd: np.ndarray | None = None
    supply_voltage: np.ndarray | None = None  # (T, J) voltage at the motor [V]
    motor_temperature: np.ndarray | None = None  # (T, J) [°C]
    # unit of the logged gains: "N·m/rad" (kd in N·m·s/rad), or "firmware" for a unit with an
    # unknown factor
    gain_unit: str = PHYSICAL_GAINS
    # known registers of FIRMWARE, equal for all motors
    firmware: Mapping[str, float] = field(default_factory=dict)
    # classes of the joints in the robot's description; if empty, the joints' names give the classes
    given_classes: tuple[str, ...] = ()
    # motor of each joint in the robot's description; empty if it states none
    motor_models: tuple[MotorModel, ...] = ()
    # MJCF of the rigid bodies that the loads come from; "" for loads from elsewhere
    bodies: str = ""
    # Joints whose commands were sent faster than they were logged, with the time between logged
    # commands [s] (`doctor.commands.command_rate`). Their constants cannot be identified.
    slow_commands: Mapping[str, float] = field(default_factory=dict)

    def overview(self) -> Overview:
        """For people: size, origin, channels, settings, and ranges of the joints."""
        required = ("time", "position_target", "joint_pos", *INTEGER_CHANNELS)
        optional = [name for name in channels(self) if name not in required]
        loads = "unknown; mp.load_log computes them from a model"
        if self.load_inertia is not None:
            loads = "known"
        facts = {
            "size": f"{self.num_rows} rows in {len(self.segment_slices())} segments, "
            f"{self.duration:.4g} s at {1.0 / self.period:.4g} Hz",
            "robot": self.robot,
            "motor": self.motor,
            "source": self.source[-100:],
            "commands": self.command_mode,
            "channels besides command and angle": ", ".join(optional) or "none",
            "loads": loads,
            "settings": settings_text(self),
        }

        columns = (
            "joint",
            "angle from [°]",
            "to [°]",
            "command from [°]",
            "to [°]",
            "angle - command, rms [mrad]",
        )
        rows = []
        series = zip(self.joint_names, self.joint_pos.T, self.position_target.T, strict=True)
        for joint, angle, command in series:
            ends = np.rad2deg([angle.min(), angle.max(), command.min(), command.max()]).tolist()
            error = 1e3 * rms(angle - command)
            rows.append([joint, *(f"{value:.1f}" for value in ends), f"{error:.0f}"])

        # without position commands, the table has the commands of the mode
        sent = {"velocity": ("velocity_target", "rad/s"), "torque": ("torque_feedforward", "N·m")}
        if self.command_mode in sent:
            name, unit = sent[self.command_mode]
            columns = (*columns[:3], f"command from [{unit}]", f"to [{unit}]")
            for row, values in zip(rows, getattr(self, name).T, strict=True):
                row[3:] = [f"{values.min():.2f}", f"{values.max():.2f}"]
        return Overview(f"motor log of {self.num_joints} joints", facts, columns, rows)

    @property
    def num_joints(self) -> int:
        """Number of joints, J."""
        return len(self.joint_names)

    @property
    def joint_classes(self) -> tuple[str, ...]:
        """(J) class of each joint's motor."""
        return motor_classes(self.joint_names, self.given_classes)

    @property
    def readings(self) -> np.ndarray:
        """(T, J) angles to compare with a simulation: as they were read, without smoothing [rad].

        Smoothed angles begin to move before the motor does, which biases delays.
        """
        return self.joint_pos if self.joint_reading is None else self.joint_reading

    @property
    def num_rows(self) -> int:
        """Number of rows, T."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """Recorded time [s], summed over segments."""
        times = [self.time[segment] for segment in self.segment_slices()]
        return float(sum(time[-1] - time[0] for time in times))

    @property
    def period(self) -> float:
        """Sample period [s]: the median time step within segments."""
        return float(np.median(time_steps(self)[1]))

    def segment_slices(self) -> list[slice]:
        """Rows of each segment, in order."""
        if self.segment is None:
            return [slice(0, self.num_rows)]
        starts = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *starts.tolist(), self.num_rows]
        return [slice(first, last) for first, last in pairwise(bounds)]

    def segments(self) -> "Iterator[MotorLog]":
        """One log per segment."""
        return map(self.rows, self.segment_slices())

    def rows(self, selection: slice | np.ndarray) -> "MotorLog":
        """The rows a slice, a mask (T,) or an index array selects."""
        values = {name: value[selection] for name, value in channels(self).items()}
        return replace(self, **values)

    def with_joints(self, joints: Sequence[int]) -> "MotorLog":
        """The log of some of its joints."""
        series = {
            name: value[:, list(joints)]
            for name, value in channels(self).items()
            if name in JOINT_SERIES
        }
        names = tuple(self.joint_names[joint] for joint in joints)
        slow = {name: value for name, value in self.slow_commands.items() if name in names}
        return replace(
            self,
            joint_names=names,
            slow_commands=slow,
            given_classes=tuple(self.joint_classes[joint] for joint in joints),
            motor_models=tuple(self.motor_models[joint] for joint in joints if self.motor_models),
            **series,
        )

    def joint(self, index: int) -> "MotorLog":
        """The log of one joint, J = 1."""
        return self.with_joints([index])

    @property
    def gains(self) -> np.ndarray | None:
        """(2, J) logged kp and kd [gain_unit]: medians over the segments of the largest in each.

        Segments in which a gain is always 0 do not count for it. kd equals kp if it is not logged,
        since models only use its ratio to the kd of other logs. kp is 1 where it has no effect: in
        velocity mode, or if it is 0 in all segments. None without gains.
        """
        if self.logged_kp is None and self.logged_kd is None:
            return None
        kp = np.ones_like(self.joint_pos) if self.logged_kp is None else self.logged_kp
        kd = kp if self.logged_kd is None else self.logged_kd
        segments = self.segment_slices()
        largest = [(kp[rows].max(axis=0), kd[rows].max(axis=0)) for rows in segments]
        medians = np.ma.median(np.ma.masked_equal(largest, 0.0), axis=0)
        return np.stack([medians[0].filled(1.0), medians[1].filled(0.0)])

    @property
    def has_command_frames(self) -> bool:
        """Whether commands consist of more than position targets at gains constant in segments."""
        return self.command_mode != "position" or gains_change(self)

    @property
    def operating_conditions(self) -> dict[str, np.ndarray]:
        """(J,) means of the logged supply voltage [V] and motor temperature [°C], by channel."""
        return {
            name: value.mean(axis=0)
            for name, value in channels(self).items()
            if name in OPERATING_CONDITIONS
        }


def channels(log: MotorLog) -> dict[str, np.ndarray]:
    """The arrays of the log by field name."""
    return {name: value for name, value in vars(log).items() if isinstance(value, np.ndarray)}


def time_steps(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """Rows (S,) that follow a row of the same segment, and the time steps (S,) to them [s]."""
    segments = log.segment_slices()
    rows = [np.arange(segment.start + 1, segment.stop) for segment in segments]
    steps = [np.diff(log.time[segment]) for segment in segments]
    return np.concatenate(rows), np.concatenate(steps)


def other_firmware(first: Mapping[str, float], second: Mapping[str, float]) -> str | None:
    """The first register in which both differ by more than 1 %, with both values, or None."""
    for name in sorted(first.keys() & second.keys()):
        if abs(first[name] - second[name]) > 0.01 * max(first[name], second[name]):
            return f"firmware.{name} {first[name]:g} and {second[name]:g}"
    return None


def log_digest(log: MotorLog) -> str:
    """SHA-256 of all fields."""
    digest = hashlib.sha256()
    for log_field in fields(log):
        value = getattr(log, log_field.name)
        text = getattr(value, "shape", value)
        digest.update(f"{log_field.name} {text!r}\n".encode())
        if isinstance(value, np.ndarray):
            digest.update(np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def motion_digest(log: MotorLog) -> str:
    """SHA-256 of commands and angles; it does not depend on names, source and loads."""
    digest = hashlib.sha256(repr(log.joint_pos.shape).encode())
    for value in (log.position_target, log.joint_pos):
        digest.update(np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()


def settings_text(log: MotorLog) -> str:
    """Command mode, gains, registers, operating conditions, slow commands, base, with units.

    They are separated by semicolons; the text is empty without any.
    """
    texts = [] if log.command_mode == "position" else [f"{log.command_mode} commands"]
    texts += gain_texts(log)
    for name, value in log.firmware.items():
        value_text = f"{value:.4g} {FIRMWARE[name].unit}".removesuffix(" 1")
        texts.append(f"{name} {value_text}" if value else f"{name} off")
    for name, values in channels(log).items():
        if name in OPERATING_CONDITIONS:
            texts.append(f"{name} {operating_condition_text(name, values.min(), values.max())}")
    for name, period in log.slow_commands.items():
        texts.append(f"commands of {name} every {1e3 * period:.3g} ms, fewer than were sent")
    if log.posture is not None:
        postures = [POSTURES[code] for code in np.unique(log.posture).tolist()]
        texts.append(f"posture {', '.join(postures)}")
    if log.base_orientation is not None:
        angles = np.rad2deg(np.median(log.base_orientation, axis=0)).tolist()
        pairs = zip(BASE_AXES, angles, strict=True)
        texts.append("base at " + ", ".join(f"{axis} {angle:.1f}°" for axis, angle in pairs))
    return "; ".join(texts)


def gain_texts(log: MotorLog) -> list[str]:
    """Each logged gain with its unit."""
    texts = []
    for name, physical_unit in (("kp", "N·m/rad"), ("kd", "N·m·s/rad")):
        gains = getattr(log, f"logged_{name}")
        if gains is None:
            continue
        ends = dict.fromkeys(f"{value:.4g}" for value in (gains.min(), gains.max()))
        unit = physical_unit if log.gain_unit == PHYSICAL_GAINS else "in firmware units"
        texts.append(f"{name} {' to '.join(ends)} {unit}")
    return texts


def range_text(low: float, high: float) -> str:
    """For example "9.6 to 12", or "12" if both are equal."""
    return " to ".join(dict.fromkeys((f"{low:.3g}", f"{high:.3g}")))


def operating_condition_text(name: str, low: float, high: float) -> str:
    """For example "9.6 to 12 V"."""
    return f"{range_text(low, high)} {OPERATING_CONDITIONS[name].unit}"


CORRECT = "correct the column map, or the file"
COPY_AGAIN = "copy or record it again"
NUMBER = "a finite number"
Where: TypeAlias = str | Path | None
_TINY = float(np.nextafter(0.0, 1.0))
# channel -> lowest and highest value, and what a value is
_BOUNDS = {
    "load_inertia": (_TINY, np.inf, "a positive inertia [kg·m²]"),
    "logged_kp": (0.0, np.inf, "a gain of 0 or more"),
    "logged_kd": (0.0, np.inf, "a gain of 0 or more"),
    "posture": (0, len(POSTURES) - 1, f"the index of one of {', '.join(POSTURES)}"),
    **{
        name: (low, high, f"from {low:g} to {high:g} {unit}")
        for name, (low, high, unit) in OPERATING_CONDITIONS.items()
    },
}


def motor_logs(logs: MotorLog | Sequence[MotorLog]) -> list[MotorLog]:
    """One log or several as a list; raises `ConfigError` for anything else."""
    if isinstance(logs, MotorLog | str | Path):
        logs = [logs]  # a path is refused below, not read letter by letter
    for log in logs:
        if not isinstance(log, MotorLog):
            raise not_a_motor_log(log)
    return list(logs)


def not_a_motor_log(value: object) -> ConfigError:
    """The error for anything else in place of a `MotorLog`, such as the path of a recording."""
    is_path = isinstance(value, str | Path)
    problem = f"{str(value)!r} is a path" if is_path else type(value).__name__
    return ConfigError(
        f"{problem}, not a MotorLog",
        remedy="read it with mp.load_log(path, columns=…, robot=…), and give the result",
        argument="log",
    )


def checked(log: MotorLog, where: Where = None) -> MotorLog:
    """The log with float64 arrays, from any array-likes, and sorted firmware registers.

    Raises:
        ConfigError: something else than a motor log, such as a path.
        LogError: wrong shape, a value that is not finite or out of its bounds, time that does not
            increase within a segment, a segment of fewer than 2 rows, channels that do not fit the
            command mode, or an unknown encoder, gain unit, command mode, posture or register; names
            ``where`` or the log's source, row, column and value.
    """
    if not isinstance(log, MotorLog):
        raise not_a_motor_log(log)
    where = where or log.source
    texts = {"encoder": ENCODERS, "gain_unit": GAIN_UNITS, "command_mode": COMMAND_MODES}
    for name, allowed in texts.items():
        value = getattr(log, name)
        if value not in allowed:
            raise LogError(f"{name} {value!r}", where=where, remedy=f"give {' or '.join(allowed)}")
    _check_firmware(log.firmware, where)

    registers = {name: float(log.firmware[name]) for name in sorted(log.firmware)}
    log = replace(_as_arrays(log, where), firmware=registers)
    for name, values in channels(log).items():
        _check_values(name, values, log.joint_names, where)
    check_command_mode(log, where)
    _check_segments(log, where)
    return log


def _check_firmware(firmware: Mapping[str, float], where: Where) -> None:
    for name, value in firmware.items():
        if name not in FIRMWARE:
            raise LogError(
                f"firmware {name!r}", where=where, remedy=f"give some of {', '.join(FIRMWARE)}"
            )
        low, high, unit = FIRMWARE[name]
        if value != 0 and not is_number(value, low, high):
            problem = f"firmware.{name} {quoted(value)} is not 0 (off) or a number"
            raise LogError(
                f"{problem} from {low:g} to {high:g}",
                where=where,
                remedy=f"give it in {unit}, or leave it out",
            )


def _check_values(
    name: str, values: np.ndarray, joint_names: tuple[str, ...], where: Where
) -> None:
    """Raise LogError for a value of a channel that is not finite or out of its bounds."""
    if values.ndim == 1:
        table = values[:, None]
        columns = [name]
    else:
        table = values
        labels = joint_names if name in JOINT_SERIES else BASE_AXES
        columns = [f"{name}/{label}" for label in labels]
    require_finite(table, columns, where)

    low, high, expected = _BOUNDS.get(name, (-np.inf, np.inf, ""))
    is_outside = (table < low) | (table > high)
    if np.any(is_outside):
        row, column = np.argwhere(is_outside)[0].tolist()
        raise bad_value(row, columns[column], table[row, column], expected, where)


def _as_arrays(log: MotorLog, where: Where) -> MotorLog:
    if log.num_joints < 1 or len(set(log.joint_names)) != log.num_joints:
        problem = f"joint names {list(log.joint_names)} are empty or repeat"
        raise LogError(problem, where=where, remedy="give every joint its own name")

    num_rows = np.size(log.time)
    shapes: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(JOINT_SERIES, (num_rows, log.num_joints)),
        "time": (num_rows,),
        **dict.fromkeys(INTEGER_CHANNELS, (num_rows,)),
        "base_orientation": (num_rows, len(BASE_AXES)),
    }
    arrays = {
        name: _as_array(name, getattr(log, name), shape, where)
        for name, shape in shapes.items()
        if getattr(log, name) is not None
    }
    return replace(log, joint_names=tuple(log.joint_names), **arrays)


def _as_array(name: str, value: Any, shape: tuple[int, ...], where: Where) -> Any:
    dtype = np.int64 if name in INTEGER_CHANNELS else np.float64
    words = "integers" if name in INTEGER_CHANNELS else "numbers"
    try:
        array = np.asarray(value).astype(dtype, casting="same_kind", copy=False)
    except (ValueError, TypeError) as error:
        problem = f"{name} is not an array of {words} ({error})"
        raise LogError(problem, where=where, remedy=f"give {words} in every row") from error
    if array.shape != shape:
        raise LogError(
            f"{name} has shape {array.shape}, expected {shape}",
            where=where,
            remedy="give one row per time and one column per joint name",
        )
    return array


def _check_segments(log: MotorLog, where: Where) -> None:
    for segment in log.segment_slices():
        num_rows = segment.stop - segment.start
        if num_rows < 2:
            index = 0
            if log.segment is not None and log.num_rows:
                index = int(log.segment[segment.start])
            problem = f"segment {index} has {num_rows} rows, at least 2 are needed"
            raise LogError(problem, where=where, remedy="record longer, or drop the segment")
        require_increasing(log.time[segment], where, segment.start)


def bad_value(
    row: int, column: str, value: Any, expected: str, where: Where, remedy: str = ""
) -> LogError:
    """The error for one cell, as "row 7, joint_pos/knee is nan, not a finite number".

    Rows count from 0.
    """
    text = quoted(value.item() if isinstance(value, np.generic) else value)
    problem = f"row {row}, {column[:120]} is {text}, not {expected}"
    return LogError(
        problem, where=where, remedy=remedy or "correct or remove the row, or leave the channel out"
    )


def missing_column(
    column_type: str, name: str, present: Iterable[str], where: Where, remedy: str = CORRECT
) -> LogError:
    """The error for a missing column, array or topic; it lists the first eight that exist."""
    names = listed([quoted(existing) for existing in present], 8) or "none"
    return LogError(
        f"no {column_type} {quoted(name, 80)}; it has {names[:300]}", where=where, remedy=remedy
    )


def unreadable(path: Path, error: Exception) -> LogError:
    """The error of a library in one line."""
    reason = (str(error) or type(error).__name__).splitlines()[0][:300]
    return LogError(f"truncated or damaged file ({reason})", where=path, remedy=COPY_AGAIN)


def require_finite(values: np.ndarray, columns: list[str], where: Where) -> None:
    """Raise LogError, with row, column and value, unless values (T, N) are finite."""
    place = first_not_finite(values)
    if place is not None:
        row, column = place
        raise bad_value(row, columns[column], values[row, column], NUMBER, where)


def require_increasing(time: np.ndarray, where: Where, first_row: int = 0) -> None:
    """Raise LogError, with row and both values, unless times (T,) [s] increase.

    The row is counted from ``first_row``.
    """
    is_stuck = np.diff(time) <= 0.0
    if not is_stuck.any():
        return
    row = 1 + int(np.argmax(is_stuck))
    previous = float(time[row - 1])
    now = float(time[row])
    fault = "repeats" if previous == now else "runs backwards"
    raise LogError(
        f"row {first_row + row}, time {fault}: {now!r} s after {previous!r} s, it must increase",
        where=where,
        remedy="sort the rows and drop duplicates, or begin a segment where the clock restarted",
    )
