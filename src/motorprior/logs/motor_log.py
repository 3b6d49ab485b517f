"""`MotorLog`: commands and measured motion of motors, in SI units."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from motorprior.robots.joint_classes import classes_by_name
from motorprior.signals import rms
from motorprior.texts import Described, Summary

# Channels of shape (T, J), and their units as written in column names
JOINT_SERIES = {
    "position_target": "rad",
    "joint_pos": "rad",
    "joint_reading": "rad",
    "joint_vel": "rad_per_s",
    "joint_torque": "N_m",
    "load_inertia": "kg_m2",
    "external_torque": "N_m",
    "load_stiffness": "N_m_per_rad",
    "stated_kp": "stated",
    "stated_kd": "stated",
    "supply_voltage": "V",
    "motor_temperature": "degC",
}
CODES = ("segment", "posture")  # integer channels of shape (T,)
BASE_AXES = ("roll", "pitch")
ENCODERS = ("joint", "rotor")
PHYSICAL_GAINS = "N·m/rad"
GAIN_UNITS = (PHYSICAL_GAINS, "firmware")
# Firmware registers and their bounds: speed [rad/s] and acceleration [rad/s²] of the profile, dead zone [rad]; 0 is off
FIRMWARE = {"profile_speed": (1e-3, 1e6), "profile_acceleration": (1e-3, 1e9), "dead_zone": (1e-6, 1.0)}
# Operating conditions and their bounds
CONDITIONS = {"supply_voltage": (0.1, 2000.0), "motor_temperature": (-60.0, 300.0)}
_GAINS = {"kp": "N·m/rad", "kd": "N·m·s/rad"}
_REGISTERS = {"profile_speed": "rad/s", "profile_acceleration": "rad/s²", "dead_zone": "rad"}
CONDITION_UNITS = {"supply_voltage": "V", "motor_temperature": "°C"}
POSTURES = ("standing", "suspended", "fixed", "fallen")  # the channel `posture` holds indices of this tuple
SIGN_CONVENTION = (
    "position error = position_target - joint_pos; a positive joint_torque accelerates joint_pos upwards; "
    "load_inertia * joint_acc = joint_torque + external_torque"
)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotorLog(Described):
    """One or more contiguous recordings (segments) of T rows and J joints.

    Construction does not check; `validity.checked` does. A row holds the measurements at its time and the command in
    force. With a known load, load_inertia·q̈ = joint_torque + external_torque. Models read gains, registers and
    conditions of a segment, or of the whole log, from `gains`, `firmware` and `conditions`.
    """

    time: np.ndarray  # (T,) [s], strictly increasing within a segment
    position_target: np.ndarray  # (T, J) commanded angle [rad]
    joint_pos: np.ndarray  # (T, J) measured angle [rad]
    joint_names: tuple[str, ...]  # J names, in column order
    robot: str  # name of the robot or bench
    motor: str  # motor model
    source: str  # file of the recording
    joint_vel: np.ndarray | None = None  # (T, J) [rad/s]
    joint_reading: np.ndarray | None = None  # (T, J) angle as it was read, where joint_pos is smoothed [rad]
    joint_torque: np.ndarray | None = None  # (T, J) torque of the motor on the joint [N·m]
    # (T, J) inertia of the load about the joint, without the motor's rotor [kg·m²]
    load_inertia: np.ndarray | None = None
    external_torque: np.ndarray | None = None  # (T, J) torque on the joint by everything except the motor [N·m]
    # (T, J) derivative of external_torque with respect to the joint's angle, at the recorded angle [N·m/rad]. A
    # simulated joint gets external_torque + load_stiffness·(simulated angle - joint_pos).
    load_stiffness: np.ndarray | None = None
    segment: np.ndarray | None = None  # (T,) index of the contiguous recording; None for a single one
    base_orientation: np.ndarray | None = None  # (T, 2) roll and pitch of the base [rad]
    posture: np.ndarray | None = None  # (T,) how the base was supported, an index of POSTURES
    # where joint_pos and joint_vel are measured: "joint", or "rotor", which does not measure backlash and elasticity of
    # the gear (angles are at the output shaft in both cases)
    encoder: str = "joint"
    stated_kp: np.ndarray | None = None  # (T, J) logged proportional gain, constant within a segment
    stated_kd: np.ndarray | None = None  # (T, J) logged derivative gain, acting on the velocity; only with stated_kp
    supply_voltage: np.ndarray | None = None  # (T, J) at the motor [V]
    motor_temperature: np.ndarray | None = None  # (T, J) [°C]
    # of the logged gains: "N·m/rad" (kd in N·m·s/rad), or "firmware" for units with an unknown factor
    gain_unit: str = PHYSICAL_GAINS
    firmware: Mapping[str, float] = field(default_factory=dict)  # known registers of FIRMWARE, equal for all motors
    stated_classes: tuple[str, ...] = ()  # `joint_classes` of the robot's description; none: by the joints' names

    def overview(self) -> Summary:
        """For people: size, origin, channels, settings, and ranges of the joints."""
        size = f"{self.num_rows} rows, {self.duration:.4g} s at {1.0 / self.period:.4g} Hz"
        segments = len(self.segment_slices())
        optional = [name for name in channels(self) if name not in ("time", "position_target", "joint_pos", *CODES)]
        facts = {
            "size": size + (f", {segments} segments" if segments > 1 else ""), "robot": self.robot,
            "motor": self.motor, "source": self.source[-100:],
            "channels besides command and angle": ", ".join(optional) or "none",
            "loads": "known" if self.load_inertia is not None else "unknown; mp.load_log computes them from a model",
            "settings": settings_text(self),
        }  # fmt: skip
        columns = ("joint", "angle from [°]", "to [°]", "command from [°]", "to [°]", "angle - command, rms [mrad]")
        rows = []
        for joint, angle, command in zip(self.joint_names, self.joint_pos.T, self.position_target.T, strict=True):
            ends = np.rad2deg([angle.min(), angle.max(), command.min(), command.max()]).tolist()
            rows.append([joint, *(f"{value:.1f}" for value in ends), f"{1e3 * rms(angle - command):.0f}"])
        return Summary(f"motor log of {self.num_joints} joints", facts, columns, rows)

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    @property
    def joint_classes(self) -> tuple[str, ...]:
        """(J) class of each joint, see `robots.joint_classes`."""
        return self.stated_classes or classes_by_name(self.joint_names)

    @property
    def readings(self) -> np.ndarray:
        """(T, J) angles [rad] to compare simulated ones with: smoothed ones begin to move before the motor."""
        return self.joint_pos if self.joint_reading is None else self.joint_reading

    @property
    def num_rows(self) -> int:
        """T."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """Recorded time [s], summed over segments."""
        return float(sum(self.time[part][-1] - self.time[part][0] for part in self.segment_slices()))

    @property
    def period(self) -> float:
        """Sample period [s]: the median time step within segments."""
        return float(np.median(time_steps(self)[1]))

    def segment_slices(self) -> list[slice]:
        """Rows of each segment, in order."""
        if self.segment is None:
            return [slice(0, self.num_rows)]
        bounds = [0, *(np.flatnonzero(np.diff(self.segment)) + 1).tolist(), self.num_rows]
        return [slice(first, last) for first, last in pairwise(bounds)]

    def segments(self) -> Iterator[MotorLog]:
        """One log per segment."""
        return map(self.rows, self.segment_slices())

    def rows(self, selection: slice | np.ndarray) -> MotorLog:
        """The rows a slice, a mask (T,) or an index array selects."""
        return replace(self, **{name: value[selection] for name, value in channels(self).items()})

    def with_joints(self, joints: Sequence[int]) -> MotorLog:
        """The log of some of its joints."""
        series = {name: value[:, list(joints)] for name, value in channels(self).items() if name in JOINT_SERIES}
        names = tuple(self.joint_names[joint] for joint in joints)
        return replace(self, joint_names=names, stated_classes=tuple(self.joint_classes[j] for j in joints), **series)

    def joint(self, index: int) -> MotorLog:
        """The log of one joint, J = 1."""
        return self.with_joints([index])

    @property
    def gains(self) -> np.ndarray | None:
        """(2, J) logged kp and kd [gain_unit], constant in a segment; of several segments the medians.

        kd equals kp if it is not logged, since models only use its ratio to that of other logs. None without gains.
        """
        if self.stated_kp is None:
            return None
        first = [part.start for part in self.segment_slices()]
        kd = self.stated_kp if self.stated_kd is None else self.stated_kd
        return np.median([self.stated_kp[first], kd[first]], axis=1)

    @property
    def conditions(self) -> dict[str, np.ndarray]:
        """(J,) mean of each logged channel of CONDITIONS."""
        return {name: value.mean(axis=0) for name, value in channels(self).items() if name in CONDITIONS}


def channels(log: MotorLog) -> dict[str, np.ndarray]:
    """The arrays of the log by field name."""
    return {name: value for name, value in vars(log).items() if isinstance(value, np.ndarray)}


def time_steps(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """Rows (S,) that follow a row of the same segment, and the time steps (S,) to them [s]."""
    parts = log.segment_slices()
    rows = np.concatenate([np.arange(part.start + 1, part.stop) for part in parts])
    return rows, np.concatenate([np.diff(log.time[part]) for part in parts])


def other_firmware(one: Mapping[str, float], other: Mapping[str, float]) -> str | None:
    """The first register in which both differ by more than 1 %, with both values, or None."""
    for name in sorted(one.keys() & other.keys()):
        if abs(one[name] - other[name]) > 0.01 * max(one[name], other[name]):
            return f"firmware.{name} {one[name]:g} and {other[name]:g}"
    return None


def log_digest(log: MotorLog) -> str:
    """SHA-256 of all fields."""
    whole = hashlib.sha256()
    for each in fields(log):
        value = getattr(log, each.name)
        whole.update(f"{each.name} {getattr(value, 'shape', value)!r}\n".encode())
        if isinstance(value, np.ndarray):
            whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()


def motion_digest(log: MotorLog) -> str:
    """SHA-256 of commands and angles; it does not depend on names, source and loads."""
    whole = hashlib.sha256(repr(log.joint_pos.shape).encode())
    for value in (log.position_target, log.joint_pos):
        whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()


def column_name(channel: str, column: int, joint_names: tuple[str, ...]) -> str:
    """Display name of a column, e.g. ``joint_pos/FR_hip``."""
    if channel in JOINT_SERIES:
        return f"{channel}/{joint_names[column]}"
    return f"{channel}/{BASE_AXES[column]}" if channel == "base_orientation" else channel


def settings_text(log: MotorLog) -> str:
    """Gains, registers and conditions with units, and postures, separated by semicolons; empty without any."""
    parts = gain_texts(log)
    for name, unit in _REGISTERS.items():
        if name in log.firmware:
            parts.append(f"{name} {log.firmware[name]:.4g} {unit}" if log.firmware[name] else f"{name} off")
    for name, values in channels(log).items():
        if name in CONDITION_UNITS:
            parts.append(f"{name} {range_text(name, values.min(), values.max())}")
    if log.posture is not None:
        parts.append(f"posture {', '.join(POSTURES[code] for code in np.unique(log.posture).tolist())}")
    return "; ".join(parts)


def gain_texts(log: MotorLog) -> list[str]:
    """Each logged gain with its unit; of more than three different values, the range."""
    texts = []
    for name, unit in _GAINS.items():
        if (gains := getattr(log, f"stated_{name}")) is not None:
            values = np.unique(gains).tolist()
            text = ", ".join(f"{value:.4g}" for value in values)
            if len(values) > 3:
                text = f"{values[0]:.4g} to {values[-1]:.4g}"
            texts.append(f"{name} {text} {unit if log.gain_unit == PHYSICAL_GAINS else 'in firmware units'}")
    return texts


def range_text(condition: str, low: float, high: float) -> str:
    """For example "9.6 to 12 V", or "12 V" if both are equal."""
    one, other = f"{low:.3g}", f"{high:.3g}"
    return f"{one if one == other else f'{one} to {other}'} {CONDITION_UNITS[condition]}"
