"""Messages between host and robot, and their msgpack payloads. Pure functions.

Keys and units are those of the firmware Nate711/DJIPupperTests (MIT). Angles have the robot's own signs, see
`sign_conventions`. Numbers travel as float32. ``temp`` and ``bat`` are not in that firmware: a robot that measures them
may send them under these names.
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
MAX_TELEMETRY = 1023  # [bytes] of payload; all keys together need about 650, a greater length is damaged
_MAX_FLOAT32 = float(np.finfo(np.float32).max)


@dataclass(frozen=True, kw_only=True)
class Command:
    """A message to the robot; a key that is None is not sent.

    Attributes:
        pos: (joints,) position targets [rad].
        kp: position gain [A/rad].
        kd: velocity gain [A·s/rad].
        max_current: current limit of every motor [A].
        idle: no current until the next target.
    """

    pos: np.ndarray | None = None
    kp: float | None = None
    kd: float | None = None
    max_current: float | None = None
    idle: bool | None = None


@dataclass(frozen=True, kw_only=True)
class Telemetry:
    """A message from the robot.

    Attributes:
        ts: time since the robot started [ms].
        yaw: [rad], like pitch and roll; 0 if the firmware does not read the IMU.
        pitch: see yaw.
        roll: see yaw.
        yaw_rate: about the body's axis [rad/s], like pitch_rate and roll_rate.
        pitch_rate: see yaw_rate.
        roll_rate: see yaw_rate.
        pos: (joints,) [rad].
        vel: (joints,) [rad/s].
        cur: (joints,) measured currents [A], if the firmware sends them.
        temp: (joints,) motor temperatures [°C], if the robot measures them.
        bat: battery voltage [V], if the robot measures it.
    """

    ts: float
    yaw: float
    pitch: float
    roll: float
    yaw_rate: float
    pitch_rate: float
    roll_rate: float
    pos: np.ndarray
    vel: np.ndarray
    cur: np.ndarray | None = None
    temp: np.ndarray | None = None
    bat: float | None = None


IDLE = Command(idle=True)

_COMMAND_KEYS = tuple(field.name for field in fields(Command))
_TELEMETRY_KEYS = tuple(field.name for field in fields(Telemetry))
_REQUIRED = _TELEMETRY_KEYS[: _TELEMETRY_KEYS.index("cur")]
_ARRAYS = ("pos", "vel", "cur", "temp")


def encode_command(command: Command, joints: int) -> bytes:
    """The payload of a command to a robot with this number of joints; numbers as float32.

    Raises:
        ProtocolError: an empty command, an array of another size, or a number that is not finite as float32.
    """
    return _encoded(command, _COMMAND_KEYS, joints, MAX_COMMAND)


def decode_command(payload: bytes, joints: int) -> Command:
    """The command in a payload, as a robot reads it; inverse of `encode_command`.

    Raises:
        ProtocolError: not a msgpack map, an unknown key, an array of another size, or a number that is not finite.
    """
    found = _unpacked(payload, joints)
    if not found or any(key not in _COMMAND_KEYS for key in found):
        raise ProtocolError(f"not a command: keys {str(list(found))[:60]}")
    return Command(**_checked(found, found, joints))


def encode_telemetry(telemetry: Telemetry, joints: int) -> bytes:
    """The payload of telemetry; numbers as float32, ``ts`` as an integer.

    Raises:
        ProtocolError: an array of another size, or a number that is not finite.
    """
    return _encoded(telemetry, _TELEMETRY_KEYS, joints, MAX_TELEMETRY)


def decode_telemetry(payload: bytes, joints: int) -> Telemetry:
    """The telemetry in a payload, as the host reads it; unknown keys are ignored.

    Raises:
        ProtocolError: not a msgpack map, a required key missing, an array of another size, or a number that is not
            finite.
    """
    found = _unpacked(payload, joints)
    if missing := [key for key in _REQUIRED if key not in found]:
        raise ProtocolError(f"telemetry without {missing}")
    return Telemetry(**_checked(found, [key for key in _TELEMETRY_KEYS if key in found], joints))


def _encoded(message: Command | Telemetry, keys: Collection[str], joints: int, max_size: int) -> bytes:
    values = {key: getattr(message, key) for key in keys if getattr(message, key) is not None}
    plain = {
        key: value.tolist() if isinstance(value, np.ndarray | np.generic) else value for key, value in values.items()
    }
    _checked(plain, plain, joints)
    if "ts" in plain:
        plain["ts"] = round(plain["ts"])
    payload = msgpack.packb(plain, use_single_float=True)
    if not plain or payload is None or len(payload) > max_size:
        raise ProtocolError(f"a message with {', '.join(plain) or 'no keys'} has no valid size")
    return payload


def _unpacked(payload: bytes, joints: int) -> dict[Any, Any]:
    try:
        # A newer firmware may send other arrays, such as foot positions: a little longer, and ignored.
        found = msgpack.unpackb(payload, max_map_len=32, max_array_len=joints + 4, max_str_len=64, max_ext_len=0)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError(f"not msgpack ({str(error)[:60]})") from error
    if not isinstance(found, dict):
        raise ProtocolError(f"a msgpack {type(found).__name__}, not a map")
    return found


def _checked(values: Mapping[Any, Any], keys: Collection[Any], joints: int) -> dict[str, Any]:
    """The values of these keys: a flag, a finite number, or an array of one finite number per joint."""
    checked: dict[str, Any] = {}
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
        checked[key] = np.array(value, dtype=np.float64) if key in _ARRAYS else value
    return checked


def _is_finite(value: Any) -> bool:
    # Not a bool: a damaged byte can turn a number into one.
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= _MAX_FLOAT32
