"""The messages between host and robot: dataclasses to msgpack and back, pure functions.

Keys and units are those of the firmware Nate711/DJIPupperTests (MIT). Angles are the robot's own: `axes` turns them
into the library's and back. Numbers travel as float32.

`temp` and `bat` are not in that firmware: a robot that measures them may send them under these names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import msgpack
import numpy as np

from motorprior.exceptions import ProtocolError
from motorprior.robots.robot import Robot

LARGEST_COMMAND = 255
"""Payload of a command [bytes]: its length travels in one byte."""
LARGEST_TELEMETRY = 1023
"""Payload of telemetry [bytes]; all keys together need about 650. A longer length is a damaged one."""
_SPARE = 4
"""An array of a newer firmware may be so much longer than the longest known one; it is passed over."""
LARGEST_FLOAT = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Sizes:
    """Lengths of the arrays in a robot's messages.

    Attributes:
        joints: of the robot.
        legs: of the robot.
    """

    joints: int
    legs: int

    @classmethod
    def of(cls, robot: Robot) -> Sizes:
        """Those of a robot."""
        return cls(robot.num_joints, len(robot.legs))

    @property
    def of_command(self) -> dict[str, int]:
        """Length of every array that a command may hold, by key."""
        feet = 3 * self.legs
        return {
            "pos": self.joints, "activations": self.joints,
            "cart_pos": feet, "cart_kp": 3, "cart_kd": 3, "ff_force": feet,
        }  # fmt: skip

    @property
    def of_telemetry(self) -> dict[str, int]:
        """Length of every array that telemetry may hold, by key."""
        return dict.fromkeys(_TELEMETRY_SERIES, self.joints)


@dataclass(frozen=True, kw_only=True)
class Command:
    """A message to the robot; a key that is None is not sent.

    Attributes:
        pos: (joints,) joint position targets [rad].
        kp: position gain [A/rad].
        kd: velocity gain [A·s/rad].
        max_current: bound of every motor's current [A].
        activations: (joints,) 1 for a motor that is driven, 0 for one that is not.
        cart_pos: (3·legs,) foot positions, legs × (x, y, z) [m].
        cart_kp: (3,) foot stiffness [A/m].
        cart_kd: (3,) foot damping [A·s/m].
        ff_force: (3·legs,) feed-forward foot forces [N].
        zero: take the present pose as zero.
        home: find the end stops.
        idle: no current, until the next target.
        debug: talkative telemetry.
    """

    pos: np.ndarray | None = None
    kp: float | None = None
    kd: float | None = None
    max_current: float | None = None
    activations: np.ndarray | None = None
    cart_pos: np.ndarray | None = None
    cart_kp: np.ndarray | None = None
    cart_kd: np.ndarray | None = None
    ff_force: np.ndarray | None = None
    zero: bool | None = None
    home: bool | None = None
    idle: bool | None = None
    debug: bool | None = None


@dataclass(frozen=True, kw_only=True)
class Telemetry:
    """A message from the robot.

    Attributes:
        ts: time since the robot started [ms].
        yaw: [rad]; so are pitch and roll. Zero where the firmware does not read the IMU.
        pitch: see yaw.
        roll: see yaw.
        yaw_rate: [rad/s]; so are pitch_rate and roll_rate.
        pitch_rate: see yaw_rate.
        roll_rate: see yaw_rate.
        pos: (joints,) [rad].
        vel: (joints,) [rad/s].
        cur: (joints,) measured current [A], where it is compiled in.
        pref: (joints,) position reference [rad].
        vref: (joints,) velocity reference [rad/s].
        cref: (joints,) current reference [A].
        lcur: (joints,) last commanded current [A].
        temp: (joints,) motor temperature [°C], where a robot measures it.
        bat: battery voltage [V], where a robot measures it.
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
    pref: np.ndarray | None = None
    vref: np.ndarray | None = None
    cref: np.ndarray | None = None
    lcur: np.ndarray | None = None
    temp: np.ndarray | None = None
    bat: float | None = None


IDLE = Command(idle=True)

_COMMAND_FLAGS = ("zero", "home", "idle", "debug")
_TELEMETRY_SERIES = ("pos", "vel", "cur", "pref", "vref", "cref", "lcur", "temp")
_COMMAND_KEYS = tuple(field.name for field in fields(Command))
_TELEMETRY_KEYS = tuple(field.name for field in fields(Telemetry))
_REQUIRED = _TELEMETRY_KEYS[: _TELEMETRY_KEYS.index("cur")]


def encode_command(command: Command, sizes: Sizes) -> bytes:
    """The payload of a command: a msgpack map of what is set, numbers as float32.

    Args:
        command: with at least one key.
        sizes: of the robot.

    Raises:
        ProtocolError: what the firmware would refuse or misread: an array of another size, a number that is not
            finite as float32, an empty command, or more than 255 bytes.
    """
    given = {key: getattr(command, key) for key in _COMMAND_KEYS if getattr(command, key) is not None}
    if not given:
        raise ProtocolError("an empty command", remedy="set at least one key")
    arrays = sizes.of_command
    plain = {key: _plain(key, value, arrays, _COMMAND_FLAGS) for key, value in given.items()}
    payload = _packed(plain)
    if len(payload) > LARGEST_COMMAND:
        raise ProtocolError(
            f"a command of {len(payload)} bytes ({', '.join(given)}), the firmware takes {LARGEST_COMMAND}",
            remedy="send the keys in several commands",
        )
    return payload


def decode_command(payload: bytes, sizes: Sizes) -> Command:
    """The command in a payload, as a robot reads it; inverse of `encode_command`.

    Raises:
        ProtocolError: not a msgpack map, an unknown key, an array of another size, or a number that is not finite.
    """
    found, arrays = _unpacked(payload, sizes), sizes.of_command
    unknown = set(found) - set(_COMMAND_KEYS)
    if unknown or not found:
        raise ProtocolError(f"unknown keys {sorted(map(repr, unknown))[:3]}" if unknown else "an empty map")
    return Command(**{key: _number(key, value, arrays, _COMMAND_FLAGS) for key, value in found.items()})


def encode_telemetry(telemetry: Telemetry, sizes: Sizes) -> bytes:
    """The payload of telemetry, numbers as float32 and ``ts`` as an integer.

    Raises:
        ProtocolError: an array of another size, a number that is not finite, or too many bytes.
    """
    values = {key: getattr(telemetry, key) for key in _TELEMETRY_KEYS if getattr(telemetry, key) is not None}
    arrays = sizes.of_telemetry
    plain: dict[str, Any] = {key: _plain(key, value, arrays, ()) for key, value in values.items()}
    plain["ts"] = round(plain["ts"])
    payload = _packed(plain)
    if len(payload) > LARGEST_TELEMETRY:
        raise ProtocolError(f"telemetry of {len(payload)} bytes is above {LARGEST_TELEMETRY}")
    return payload


def decode_telemetry(payload: bytes, sizes: Sizes) -> Telemetry:
    """The telemetry in a payload, as the host reads it; keys of a newer firmware are passed over.

    Raises:
        ProtocolError: not a msgpack map, a required key missing, an array of another size, or a number that is
            not finite.
    """
    found, arrays = _unpacked(payload, sizes), sizes.of_telemetry
    missing = [key for key in _REQUIRED if key not in found]
    if missing:
        raise ProtocolError(f"telemetry without {missing}")
    known = {key: found[key] for key in _TELEMETRY_KEYS if key in found}
    return Telemetry(**{key: _number(key, value, arrays, ()) for key, value in known.items()})


def _packed(values: Mapping[str, Any]) -> bytes:
    packed = msgpack.packb(values, use_single_float=True)
    assert packed is not None
    return packed


def _unpacked(payload: bytes, sizes: Sizes) -> dict[Any, Any]:
    """A msgpack map of at most 32 entries, or an error; never anything else."""
    longest = max(sizes.joints, 3 * sizes.legs, 3) + _SPARE
    try:
        found = msgpack.unpackb(payload, max_map_len=32, max_array_len=longest, max_str_len=64, max_ext_len=0)
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError(f"not msgpack ({str(error)[:60]})") from error
    if not isinstance(found, dict):
        raise ProtocolError(f"a msgpack {type(found).__name__}, not a map")
    return found


def _plain(key: str, value: Any, arrays: Mapping[str, int], flags: tuple[str, ...]) -> Any:
    """A value as msgpack takes it, after the checks of `_number`."""
    checked = _number(key, _without_numpy(value), arrays, flags)
    return checked.tolist() if isinstance(checked, np.ndarray) else checked


def _without_numpy(value: Any) -> Any:
    """Arrays and numpy's numbers, alone or in a list, as Python's own."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_without_numpy(item) for item in value] if isinstance(value, list | tuple) else value


def _number(key: str, value: Any, arrays: Mapping[str, int], flags: tuple[str, ...]) -> Any:
    """A flag, a finite number, or an array of the wanted size of them.

    Raises:
        ProtocolError: anything else.
    """
    if key in flags:
        if type(value) is not bool:
            raise ProtocolError(f"{key} is {_short(value)}, not true or false")
        return value
    if key not in arrays:
        if not _is_finite(value):
            raise ProtocolError(f"{key} is {_short(value)}, not a finite float32")
        return float(value)
    if not isinstance(value, list | tuple) or len(value) != arrays[key]:
        size = len(value) if isinstance(value, list | tuple) else _short(value)
        raise ProtocolError(f"{key} has {size} values, the firmware takes {arrays[key]}")
    for index, item in enumerate(value):
        if not _is_finite(item):
            raise ProtocolError(f"{key}[{index}] is {_short(item)}, not a finite float32")
    return np.array(value, dtype=np.float64)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= LARGEST_FLOAT


def _short(value: Any) -> str:
    return repr(value)[:40]
