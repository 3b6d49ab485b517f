"""Messages between host and robot, and their frames on the wire.

    host to robot   0x00, one length byte, payload
    robot to host   0x45 0x45, length as 16 bit big-endian, payload, CR LF

The robot also sends lines of plain text between frames.

The payload is msgpack with numbers as float32. The firmware Nate711/DJIPupperTests (MIT) defines
keys and units. Angles have the robot's own signs.

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
        """Telemetry whose positions, velocities and currents are multiplied by (joints,) ``signs``.

        This converts from the robot's signs to the library's, and back.
        """
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
    """Frame of a message on the wire: start, length of the payload, payload, end."""

    # Maximum length of the payload [bytes]. The length field of a command is one byte; telemetry
    # with all keys needs about 650 bytes.
    max_payload: int
    start: bytes  # bytes before the length field
    length_bytes: int  # size of the length field, which is big-endian [bytes]
    end: bytes  # bytes after the payload


_FORMATS: dict[type, _Format] = {
    Command: _Format(255, b"\x00", 1, b""),
    Telemetry: _Format(1023, b"\x45\x45", 2, b"\r\n"),
}
_ARRAYS = ("pos", "vel", "cur")
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
_MAX_LINE = 256  # maximum length of a line of text; only the end of a longer line is kept [bytes]
# The printable end of a line; the bytes before it may be the rest of a damaged frame.
_PRINTABLE_END = re.compile(rb"[\x20-\x7e\t]{4,}$")
_MAP_STARTS = (*range(0x80, 0x90), 0xDE, 0xDF)  # bytes with which a msgpack map can begin


def encode_message(message: Command | Telemetry, joints: int) -> bytes:
    """The payload of a message to or from a robot with this number of joints.

    Raises ProtocolError for a message without keys, with an invalid value, or that is too long.
    """
    values: dict[str, Any] = {}
    for key, value in vars(message).items():
        if isinstance(value, np.ndarray | np.generic):
            values[key] = value.tolist()
        elif value is not None:
            values[key] = value
    _validated(values, joints)
    if "ts" in values:
        values["ts"] = round(values["ts"])

    payload = msgpack.packb(values, use_single_float=True)
    max_payload = _FORMATS[type(message)].max_payload
    if not values or payload is None or len(payload) > max_payload:
        raise ProtocolError(f"a message with {', '.join(values) or 'no keys'} has no valid size")
    return payload


def decode_message(payload: bytes, message_type: type[Message], joints: int) -> Message:
    """Decode a command or telemetry.

    Unknown keys of telemetry are ignored; unknown keys of a command are an error, as in the
    firmware. Raises ProtocolError for a payload that is not a valid message.
    """
    try:
        # A newer firmware may send longer arrays, such as foot positions, which are ignored.
        values = msgpack.unpackb(
            payload, max_map_len=32, max_array_len=joints + 4, max_str_len=64, max_ext_len=0
        )
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise ProtocolError("not msgpack") from error
    if not isinstance(values, dict) or not values:
        raise ProtocolError("not a msgpack map with keys")
    if message_type is Telemetry:
        names = [field.name for field in fields(message_type)]
        values = {name: values[name] for name in names if name in values}
    try:
        return message_type(**_validated(values, joints))
    except TypeError as error:
        raise ProtocolError(f"unknown or missing keys in a {message_type.__name__}") from error


def _validated(values: Mapping[str, Any], joints: int) -> dict[str, Any]:
    """The values: a flag, a finite number, or an array of one finite number per joint."""
    validated: dict[str, Any] = {}
    for key, value in values.items():
        if not _is_valid(key, value, joints):
            raise ProtocolError(
                f"{key} is {str(value)[:60]}: not valid for a robot with {joints} joints"
            )
        validated[key] = np.array(value, dtype=np.float64) if key in _ARRAYS else value
    return validated


def _is_valid(key: str, value: Any, joints: int) -> bool:
    if key == "idle":
        return type(value) is bool
    if key in _ARRAYS:
        return isinstance(value, list) and len(value) == joints and all(map(_is_finite, value))
    return _is_finite(value)


def _is_finite(value: Any) -> bool:
    if type(value) not in (int, float):  # a damaged byte can turn a number into a bool
        return False
    return math.isfinite(value) and abs(value) <= _MAX_FLOAT32


def framed(message: Command | Telemetry, joints: int) -> bytes:
    """The bytes of a message on the wire; raises as `encode_message`."""
    form = _FORMATS[type(message)]
    payload = encode_message(message, joints)
    return form.start + len(payload).to_bytes(form.length_bytes, "big") + payload + form.end


IDLE = Command(idle=True)
IDLE_FRAME = framed(IDLE, 0)  # the same for every robot: it holds no array


class FrameReader(Generic[Message]):
    """Reads messages of one type and lines of text from bytes.

    It buffers at most one frame and one line.
    """

    def __init__(self, message_type: type[Message], joints: int):
        self._message_type = message_type
        self._joints = joints
        self._format = _FORMATS[message_type]
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
        start = buffer.find(form.start)
        if start > 0:
            self._skip(start, out)
            return True
        if start < 0:
            self._skip(len(buffer) - self._num_start_bytes(), out)
            return False

        payload_start = len(form.start) + form.length_bytes
        if len(buffer) < payload_start:
            return False
        length = int.from_bytes(buffer[len(form.start) : payload_start], "big")
        payload_end = payload_start + length
        frame_end = payload_end + len(form.end)
        # a payload that has not begun to arrive may still be a map
        is_map = len(buffer) == payload_start or buffer[payload_start] in _MAP_STARTS
        is_possible = 0 < length <= form.max_payload and is_map
        if is_possible and len(buffer) < frame_end:
            return False

        try:
            if not is_possible or buffer[payload_end:frame_end] != form.end:
                raise ProtocolError("an impossible length, or no end of the frame")
            payload = bytes(buffer[payload_start:payload_end])
            out.append(decode_message(payload, self._message_type, self._joints))
            del buffer[:frame_end]
        except ProtocolError:
            self.rejected += 1
            self._skip(1, out)
        return True

    def _num_start_bytes(self) -> int:
        """Number of bytes at the end of the buffer that may begin the start of a frame."""
        start = self._format.start
        for number in range(len(start) - 1, 0, -1):
            if self._buffer.endswith(start[:number]):
                return number
        return 0

    def _skip(self, count: int, out: list[Message | str]) -> None:
        """Remove ``count`` bytes outside frames; printable lines among them are added to ``out``.

        A line ends with a line feed; its beginning may have been removed by earlier calls.
        """
        *lines, rest = (self._line + self._buffer[:count]).split(b"\n")
        del self._buffer[:count]
        self._line = rest[-_MAX_LINE:]
        for line in lines:
            text = _PRINTABLE_END.search(line[-_MAX_LINE:].rstrip(b"\r"))
            if text:
                out.append(text.group().decode("ascii").strip())
