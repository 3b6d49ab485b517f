"""Messages between host and robot, and their msgpack payloads, with numbers as float32.

Keys and units are those of the firmware Nate711/DJIPupperTests (MIT). Angles have the robot's own signs, see
`Wire.signs`. ``temp`` and ``bat`` are not in that firmware; a robot that measures them may send these keys.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import msgpack
import numpy as np

from motorprior.exceptions import ProtocolError

_MAX_FLOAT32 = float(np.finfo(np.float32).max)


@dataclass(frozen=True, kw_only=True)
class Command:
    """A message to the robot; a key that is None is not sent."""

    pos: np.ndarray | None = None  # (joints,) position targets [rad]
    kp: float | None = None  # position gain [A/rad]
    kd: float | None = None  # velocity gain [A·s/rad]
    max_current: float | None = None  # limit of every motor [A]
    idle: bool | None = None  # no current until the next target


@dataclass(frozen=True, kw_only=True)
class Telemetry:
    """A message from the robot; optional keys are None if the firmware does not send them."""

    ts: float  # time since the robot started [ms]
    yaw: float  # angles [rad] and rates about the body's axes [rad/s]; all 0 if the firmware does not read the IMU
    pitch: float
    roll: float
    yaw_rate: float
    pitch_rate: float
    roll_rate: float
    pos: np.ndarray  # (joints,) [rad]
    vel: np.ndarray  # (joints,) [rad/s]
    cur: np.ndarray | None = None  # (joints,) measured currents [A]
    temp: np.ndarray | None = None  # (joints,) motor temperatures [°C]
    bat: float | None = None  # battery voltage [V]

    def with_signs(self, signs: np.ndarray) -> Telemetry:
        """The same with (joints,) ``signs`` on positions, velocities and currents, to the library's signs or back."""
        current = None if self.cur is None else signs * self.cur
        return replace(self, pos=signs * self.pos, vel=signs * self.vel, cur=current)

    @property
    def attitude(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw [rad]."""
        return self.roll, self.pitch, self.yaw

    @property
    def rates(self) -> tuple[float, float, float]:
        """Rates about the body's axes x, y, z [rad/s]."""
        return self.roll_rate, self.pitch_rate, self.yaw_rate

    @property
    def has_imu(self) -> bool:
        """False if the attitude and rates are exactly 0, as the current firmware sends."""
        return any((self.roll, self.pitch, *self.rates))


IDLE = Command(idle=True)
# [bytes]: the length of a command travels in one byte; all keys of telemetry need about 650
MAX_PAYLOAD: dict[type, int] = {Command: 255, Telemetry: 1023}
Message = TypeVar("Message", bound=Command | Telemetry)
_KEYS = {kind: tuple(field.name for field in fields(kind)) for kind in (Command, Telemetry)}
_REQUIRED = _KEYS[Telemetry][: _KEYS[Telemetry].index("cur")]
_ARRAYS = ("pos", "vel", "cur", "temp")


def encode(message: Command | Telemetry, joints: int) -> bytes:
    """Encode a message to or from a robot with this number of joints; ``ts`` as an integer.

    Raises:
        ProtocolError: no keys, an array of another size, or a number that is not finite as float32.
    """
    values = {key: value for key, value in vars(message).items() if value is not None}
    values = {key: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for key, v in values.items()}
    _validated(values, joints)
    if "ts" in values:
        values["ts"] = round(values["ts"])
    payload = msgpack.packb(values, use_single_float=True)
    if not values or payload is None or len(payload) > MAX_PAYLOAD[type(message)]:
        raise ProtocolError(f"a message with {', '.join(values) or 'no keys'} has no valid size")
    return payload


def decode(payload: bytes, kind: type[Message], joints: int) -> Message:
    """Decode a command, as the firmware does, or telemetry, of which unknown keys are ignored.

    Raises:
        ProtocolError: an invalid payload, a command without or with unknown keys, or telemetry with missing ones.
    """
    try:
        # A newer firmware may send longer arrays, such as foot positions, which are ignored.
        values = msgpack.unpackb(payload, max_map_len=32, max_array_len=joints + 4, max_str_len=64, max_ext_len=0)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError("not msgpack") from error
    if not isinstance(values, dict) or not values:
        raise ProtocolError("not a msgpack map with keys")
    known = {key: values[key] for key in _KEYS[kind] if key in values}
    complete = len(known) == len(values) if kind is Command else all(key in known for key in _REQUIRED)
    if not complete:
        raise ProtocolError(f"unknown or missing keys in a {kind.__name__}")
    return kind(**_validated(known, joints))


def _validated(values: Mapping[str, Any], joints: int) -> dict[str, Any]:
    """The values: a flag, a finite number, or an array of one finite number per joint."""
    validated: dict[str, Any] = {}
    for key, value in values.items():
        if key == "idle":
            valid = type(value) is bool
        elif key in _ARRAYS:
            valid = isinstance(value, list) and len(value) == joints and all(map(_is_finite, value))
        else:
            valid = _is_finite(value)
        if not valid:
            raise ProtocolError(f"{key} is {str(value)[:60]}: not valid for a robot with {joints} joints")
        validated[key] = np.array(value, dtype=np.float64) if key in _ARRAYS else value
    return validated


def _is_finite(value: Any) -> bool:
    # Not a bool: a damaged byte can turn a number into one.
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= _MAX_FLOAT32
