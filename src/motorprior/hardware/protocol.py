"""Messages between host and robot, and their frames on the wire.

    host to robot   0x00, one length byte, payload
    robot to host   0x45 0x45, length as 16 bit big-endian, payload, CR LF; lines of plain text between frames

The payload is msgpack with numbers as float32. Keys and units are those of the firmware
Nate711/DJIPupperTests (MIT). Angles have the robot's own signs.

There is no checksum. A frame is accepted if its length is possible, its end marker is in place and
its payload decodes; otherwise the reader skips one byte and searches on. The result does not depend
on how the stream was cut into reads.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Generic, NamedTuple, TypeVar

import msgpack
import numpy as np

from motorprior.exceptions import ProtocolError


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
    """A message from the robot; ``cur`` is None if the firmware does not send it."""

    ts: float  # time since the robot started [ms]
    # angles [rad] and rates about the body's axes [rad/s]; all 0 if the firmware does not read the
    # IMU
    yaw: float
    pitch: float
    roll: float
    yaw_rate: float
    pitch_rate: float
    roll_rate: float
    pos: np.ndarray  # (joints,) [rad]
    vel: np.ndarray  # (joints,) [rad/s]
    cur: np.ndarray | None = None  # (joints,) measured currents [A]

    def with_signs(self, signs: np.ndarray) -> "Telemetry":
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


Message = TypeVar("Message", bound=Command | Telemetry)


class _Format(NamedTuple):
    # [bytes]; the length of a command is one byte; all keys of telemetry need about 650
    max_payload: int
    start: bytes  # before the length
    length_bytes: int  # size of the length, big-endian
    end: bytes  # after the payload


_FORMATS: dict[type, _Format] = {
    Command: _Format(255, b"\x00", 1, b""),
    Telemetry: _Format(1023, b"\x45\x45", 2, b"\r\n"),
}
_ARRAYS = ("pos", "vel", "cur")
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
_MAX_LINE = 256  # [bytes]; of a longer line of text only the end is kept
# Only the printable end of a line: what precedes it may be the rest of a damaged frame.
_PRINTABLE_END = re.compile(rb"[\x20-\x7e\t]{4,}$")
_MAP_STARTS = (*range(0x80, 0x90), 0xDE, 0xDF)  # bytes with which a msgpack map can begin


def encode_message(message: Command | Telemetry, joints: int) -> bytes:
    """The payload of a message to or from a robot with this number of joints; ProtocolError for an invalid one."""
    values = {key: value for key, value in vars(message).items() if value is not None}
    values = {
        key: v.tolist() if isinstance(v, np.ndarray | np.generic) else v
        for key, v in values.items()
    }
    _validated(values, joints)
    if "ts" in values:
        values["ts"] = round(values["ts"])
    payload = msgpack.packb(values, use_single_float=True)
    if not values or payload is None or len(payload) > _FORMATS[type(message)].max_payload:
        raise ProtocolError(f"a message with {', '.join(values) or 'no keys'} has no valid size")
    return payload


def decode_message(payload: bytes, kind: type[Message], joints: int) -> Message:
    """Decode a command, as the firmware does, or telemetry, of which unknown keys are ignored; or ProtocolError."""
    try:
        # A newer firmware may send longer arrays, such as foot positions, which are ignored.
        values = msgpack.unpackb(
            payload, max_map_len=32, max_array_len=joints + 4, max_str_len=64, max_ext_len=0
        )
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError("not msgpack") from error
    if not isinstance(values, dict) or not values:
        raise ProtocolError("not a msgpack map with keys")
    if kind is Telemetry:
        values = {field.name: values[field.name] for field in fields(kind) if field.name in values}
    try:
        return kind(**_validated(values, joints))
    except TypeError as error:
        raise ProtocolError(f"unknown or missing keys in a {kind.__name__}") from error


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
            raise ProtocolError(
                f"{key} is {str(value)[:60]}: not valid for a robot with {joints} joints"
            )
        validated[key] = np.array(value, dtype=np.float64) if key in _ARRAYS else value
    return validated


def _is_finite(value: Any) -> bool:
    # Not a bool: a damaged byte can turn a number into one.
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= _MAX_FLOAT32


def framed(message: Command | Telemetry, joints: int) -> bytes:
    """The bytes of a message on the wire; raises as `encode_message`."""
    form = _FORMATS[type(message)]
    payload = encode_message(message, joints)
    return form.start + len(payload).to_bytes(form.length_bytes, "big") + payload + form.end


IDLE = Command(idle=True)
IDLE_FRAME = framed(IDLE, 0)  # the same for every robot: it holds no array


class FrameReader(Generic[Message]):
    """Reads messages of a kind and lines of text from bytes; it buffers at most one frame and one line."""

    def __init__(self, kind: type[Message], joints: int):
        self._kind = kind
        self._joints = joints
        self._format = _FORMATS[kind]
        self._buffer = bytearray()
        self._line = b""
        self.rejected = 0  # frame starts without a valid frame

    def feed(self, data: bytes) -> list[Message | str]:
        """Messages and lines that ``data`` completes, in order."""
        self._buffer += data
        out: list[Message | str] = []
        while self._advance(out):
            pass
        return out

    def _advance(self, out: list[Message | str]) -> bool:
        """Read one frame or skip bytes; False when more bytes are needed."""
        form = self._format
        buffer = self._buffer
        at = buffer.find(form.start)
        if at > 0:
            self._skip(at, out)
            return True
        if at < 0:  # the last bytes may become a start
            may_start = next(
                (n for n in range(len(form.start) - 1, 0, -1) if buffer.endswith(form.start[:n])), 0
            )
            self._skip(len(buffer) - may_start, out)
            return False
        head = len(form.start) + form.length_bytes
        if len(buffer) < head:
            return False
        length = int.from_bytes(buffer[len(form.start) : head], "big")
        total = head + length + len(form.end)
        possible = 0 < length <= form.max_payload and (
            len(buffer) == head or buffer[head] in _MAP_STARTS
        )
        if possible and len(buffer) < total:
            return False
        try:
            if not possible or buffer[total - len(form.end) : total] != form.end:
                raise ProtocolError("an impossible length, or no end of the frame")
            out.append(
                decode_message(bytes(buffer[head : head + length]), self._kind, self._joints)
            )
            del buffer[:total]
        except ProtocolError:
            self.rejected += 1
            self._skip(1, out)
        return True

    def _skip(self, count: int, out: list[Message | str]) -> None:
        """Remove bytes outside frames; they are text if printable and ended by a line feed."""
        *lines, rest = (self._line + self._buffer[:count]).split(b"\n")
        del self._buffer[:count]
        self._line = rest[-_MAX_LINE:]
        for line in lines:
            if text := _PRINTABLE_END.search(line[-_MAX_LINE:].rstrip(b"\r")):
                out.append(text.group().decode("ascii").strip())
