"""`MotorLog`: commands and measured motion of motors, in SI units."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from motorprior.bounds import is_number

JOINT_SERIES = {
    "position_target": "rad",
    "joint_pos": "rad",
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
"""Channels of shape (T, J) and their unit, as it is spelled in column names."""

BASE_AXES = ("roll", "pitch")
ENCODERS = ("joint", "rotor")
PHYSICAL_GAINS = "N·m/rad"
GAIN_UNITS = (PHYSICAL_GAINS, "firmware")
FIRMWARE = {"profile_speed": (1e-3, 1e6), "profile_acceleration": (1e-3, 1e9), "dead_zone": (1e-6, 1.0)}
"""Registers of a servo's firmware that a log may state, and their bounds: the largest speed [rad/s] and acceleration
[rad/s²] of its profile, and the error [rad] that it does not act on. 0: off."""
CONDITIONS = {"supply_voltage": (0.1, 2000.0), "motor_temperature": (-60.0, 300.0)}
"""Channels of what motors work under, and their bounds [V], [°C]."""
CONDITION_UNITS = {"supply_voltage": "V", "motor_temperature": "°C"}
_ALIKE = 0.01
"""Share by which two statements of a register may differ: one may be rounded."""
POSTURES = ("standing", "suspended", "fixed", "fallen")
"""Of a robot: on its feet; base held in the air, feet free; bolted down; on its side or back. The channel `posture`
holds the place of one of them in this list."""
CODES = ("segment", "posture")
"""Channels of shape (T,) that are whole numbers."""
SIGN_CONVENTION = (
    "position error = position_target - joint_pos; a positive joint_torque accelerates joint_pos upwards; "
    "load_inertia * joint_acc = joint_torque + external_torque"
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MotorLog:
    """One or more contiguous recordings of T rows and J joints.

    Construction checks nothing; `validity.checked` does. A row holds the command in force and the measurements
    made at its time. With a known load (bench): load_inertia·q̈ = joint_torque + external_torque.

    Attributes:
        time: (T,) [s], strictly increasing within a segment.
        position_target: (T, J) commanded angle [rad].
        joint_pos: (T, J) measured angle [rad].
        joint_names: J names, in column order.
        robot: robot or bench the joints belong to.
        motor: motor model.
        source: where the log comes from.
        joint_vel: (T, J) [rad/s], or None.
        joint_torque: (T, J) torque of the motor on the joint [N·m], or None.
        load_inertia: (T, J) inertia of the known load, at the joint [kg·m²], or None.
        external_torque: (T, J) torque of everything but the motor on the joint [N·m], or None.
        load_stiffness: (T, J) change of external_torque with the joint's own angle, as that of gravity, at the recorded
            angle [N·m/rad], or None. A simulated joint gets external_torque + load_stiffness·(its angle - joint_pos).
        segment: (T,) index of the contiguous recording a row belongs to, or None for a single one.
        base_orientation: (T, 2) roll and pitch of the robot's base [rad], or None.
        posture: (T,) how the robot's base was held in a row, see POSTURES, or None where nobody said.
        encoder: where joint_pos and joint_vel are measured: "joint", or "rotor", to which the gear's play and wind-up
            are invisible (angles at the output shaft, too).
        stated_kp: (T, J) proportional gain that the motor was told, constant within a segment, or None.
        stated_kd: (T, J) the same for the derivative gain, which acts on the velocity; only with stated_kp.
        supply_voltage: (T, J) at the motor [V], or None.
        motor_temperature: (T, J) [°C], or None.
        gain_unit: of the stated gains: "N·m/rad" (and N·m·s/rad), which are then the motor's, or "firmware", units of
            its own, of which the motor's gains are unknown multiples.
        firmware: registers of FIRMWARE that all these motors were told, where somebody knows them.
    """

    time: np.ndarray
    position_target: np.ndarray
    joint_pos: np.ndarray
    joint_names: tuple[str, ...]
    robot: str
    motor: str
    source: str
    joint_vel: np.ndarray | None = None
    joint_torque: np.ndarray | None = None
    load_inertia: np.ndarray | None = None
    external_torque: np.ndarray | None = None
    load_stiffness: np.ndarray | None = None
    segment: np.ndarray | None = None
    base_orientation: np.ndarray | None = None
    posture: np.ndarray | None = None
    encoder: str = "joint"
    stated_kp: np.ndarray | None = None
    stated_kd: np.ndarray | None = None
    supply_voltage: np.ndarray | None = None
    motor_temperature: np.ndarray | None = None
    gain_unit: str = PHYSICAL_GAINS
    firmware: Mapping[str, float] = field(default_factory=dict)

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    @property
    def num_rows(self) -> int:
        """T."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """Recorded time [s]: the sum over segments, without the pauses between them."""
        return float(sum(self.time[part][-1] - self.time[part][0] for part in self.segment_slices()))

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

    def segments(self) -> Iterator[MotorLog]:
        """One log per contiguous recording; each keeps its `segment` index."""
        for part in self.segment_slices():
            yield self.rows(part)

    def rows(self, selection: slice | np.ndarray) -> MotorLog:
        """The rows a slice, a mask (T,) or an index array selects."""
        picked = {name: value[selection] for name, value in channels(self).items()}
        return replace(self, **picked)

    def joint(self, index: int) -> MotorLog:
        """The same log with one joint, J = 1."""
        series = {name: value[:, [index]] for name, value in channels(self).items() if name in JOINT_SERIES}
        return replace(self, joint_names=(self.joint_names[index],), **series)


def channels(log: MotorLog) -> dict[str, np.ndarray]:
    """Every array that the log holds, by field name."""
    values = {each.name: getattr(log, each.name) for each in fields(log)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def time_steps(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """Row and length [s] of every step from the previous row of the same segment.

    Returns:
        ``rows`` (S,), the later row of each pair, and ``steps`` (S,) [s].
    """
    parts = log.segment_slices()
    rows = np.concatenate([np.arange(part.start + 1, part.stop) for part in parts])
    return rows, np.concatenate([np.diff(log.time[part]) for part in parts])


def stated_gain_rows(log: MotorLog) -> np.ndarray | None:
    """(2, T, J) stated kp and kd, kd equal to kp where it is not stated; None if none are."""
    if log.stated_kp is None:
        return None
    return np.stack([log.stated_kp, log.stated_kp if log.stated_kd is None else log.stated_kd])


def stated_gains_of(log: MotorLog) -> np.ndarray | None:
    """(2, J) medians of `stated_gain_rows` over segments, or None."""
    rows = stated_gain_rows(log)
    return None if rows is None else np.median(rows[:, [part.start for part in log.segment_slices()]], axis=1)


def segment_means(log: MotorLog, channel: str) -> np.ndarray:
    """(S, J) means over the rows of each segment of a channel (T, J) that the log has."""
    values = getattr(log, channel)
    return np.array([values[part].mean(axis=0) for part in log.segment_slices()])


def is_register(name: str, value: object) -> bool:
    """Whether a register of FIRMWARE can hold this value, which 0 is where it is off."""
    return is_number(value, 0.0, 0.0) or is_number(value, *FIRMWARE[name])


def other_firmware(one: Mapping[str, float], other: Mapping[str, float]) -> str | None:
    """The first register that both state otherwise, with both values, or None."""
    for name in sorted(one.keys() & other.keys()):
        if abs(one[name] - other[name]) > _ALIKE * max(one[name], other[name]):
            return f"firmware.{name} {one[name]:g} and {other[name]:g}"
    return None


def log_digest(log: MotorLog) -> str:
    """SHA-256 of all that the log holds."""
    whole = hashlib.sha256()
    for each in fields(log):
        value = getattr(log, each.name)
        whole.update(f"{each.name} {getattr(value, 'shape', value)!r}\n".encode())
        if isinstance(value, np.ndarray):
            whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()


def motion_digest(log: MotorLog) -> str:
    """SHA-256 of commands and angles: the same of one recording whatever its name and whatever loads it was given."""
    whole = hashlib.sha256(repr(log.joint_pos.shape).encode())
    for value in (log.position_target, log.joint_pos):
        whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()


def column_name(channel: str, column: int, joint_names: tuple[str, ...]) -> str:
    """The name a user reads for one column of a channel, e.g. ``joint_pos/FR_hip``."""
    if channel in JOINT_SERIES:
        return f"{channel}/{joint_names[column]}"
    return f"{channel}/{BASE_AXES[column]}" if channel == "base_orientation" else channel
