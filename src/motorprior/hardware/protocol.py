"""Messages between host and robot, and their msgpack payloads, with numbers as float32.

Keys and units are those of the firmware Nate711/DJIPupperTests (MIT). Angles have the robot's own signs, see
`wire_conversion`. ``temp`` and ``bat`` are not in that firmware; a robot that measures them may send these keys.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import msgpack
import numpy as np

from motorprior.exceptions import ProtocolError

MAX_COMMAND = 255  # [bytes] of payload: the length of a command travels in one byte
MAX_TELEMETRY = 1023  # [bytes] of payload; all keys need about 650, so a greater length is damaged
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


IDLE = Command(idle=True)

_COMMAND_KEYS = tuple(field.name for field in fields(Command))
_TELEMETRY_KEYS = tuple(field.name for field in fields(Telemetry))
_REQUIRED = _TELEMETRY_KEYS[: _TELEMETRY_KEYS.index("cur")]
_ARRAYS = ("pos", "vel", "cur", "temp")


def encode(message: Command | Telemetry, joints: int) -> bytes:
    """Encode a message to or from a robot with this number of joints; ``ts`` as an integer.

    Raises:
        ProtocolError: no keys, an array of another size, or a number that is not finite as float32.
    """
    values = {key: value for key, value in vars(message).items() if value is not None}
    values = {key: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for key, v in values.items()}
    _validated(values, values, joints)
    if "ts" in values:
        values["ts"] = round(values["ts"])
    payload = msgpack.packb(values, use_single_float=True)
    max_size = MAX_COMMAND if isinstance(message, Command) else MAX_TELEMETRY
    if not values or payload is None or len(payload) > max_size:
        raise ProtocolError(f"a message with {', '.join(values) or 'no keys'} has no valid size")
    return payload


def decode_command(payload: bytes, joints: int) -> Command:
    """Decode a command, as the firmware does; raises ProtocolError for an invalid payload or unknown key."""
    values = _unpack(payload, joints)
    if not values or any(key not in _COMMAND_KEYS for key in values):
        raise ProtocolError("not a command")
    return Command(**_validated(values, values, joints))


def decode_telemetry(payload: bytes, joints: int) -> Telemetry:
    """Decode telemetry; raises ProtocolError for an invalid payload or missing key. Unknown keys are ignored."""
    values = _unpack(payload, joints)
    if any(key not in values for key in _REQUIRED):
        raise ProtocolError("incomplete telemetry")
    return Telemetry(**_validated(values, [key for key in _TELEMETRY_KEYS if key in values], joints))


def _unpack(payload: bytes, joints: int) -> dict[Any, Any]:
    try:
        # A newer firmware may send longer arrays, such as foot positions, which are ignored.
        values = msgpack.unpackb(payload, max_map_len=32, max_array_len=joints + 4, max_str_len=64, max_ext_len=0)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError("not msgpack") from error
    if not isinstance(values, dict):
        raise ProtocolError("not a msgpack map")
    return values


def _validated(values: Mapping[Any, Any], keys: Collection[Any], joints: int) -> dict[str, Any]:
    """The values of these keys: a flag, a finite number, or an array of one finite number per joint."""
    validated: dict[str, Any] = {}
    for key in keys:
        value = values[key]
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
