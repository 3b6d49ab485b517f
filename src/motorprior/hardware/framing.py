"""Frames in a stream of bytes, and resynchronisation after noise.

    host to robot   0x00, one length byte, payload
    robot to host   0x45 0x45, length as 16 bit big-endian, payload, CR LF; lines of plain text between frames

There is no checksum. A frame is accepted if its length is possible, its end marker is in place and its payload decodes;
otherwise the reader skips one byte and searches on. The result does not depend on how the stream was cut into reads.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Generic

from motorprior.exceptions import ProtocolError
from motorprior.hardware.protocol import IDLE, MAX_PAYLOAD, Command, Message, Telemetry, decode, encode

MAX_LINE = 256  # [bytes]; of a longer line of text only the end is kept
# Only the printable end of a line: what precedes it may be the rest of a damaged frame.
_PRINTABLE_END = re.compile(rb"[\x20-\x7e\t]{4,}$")


@dataclass(frozen=True)
class _Framing:
    """Layout of a frame."""

    start: bytes  # before the length
    length_bytes: int  # size of the length, big-endian
    end: bytes  # after the payload


_FRAMINGS: dict[type, _Framing] = {Command: _Framing(b"\x00", 1, b""), Telemetry: _Framing(b"\x45\x45", 2, b"\r\n")}


def framed(message: Command | Telemetry, joints: int) -> bytes:
    """The bytes of a message on the wire; raises as `encode`."""
    framing, payload = _FRAMINGS[type(message)], encode(message, joints)
    return framing.start + len(payload).to_bytes(framing.length_bytes, "big") + payload + framing.end


IDLE_FRAME = framed(IDLE, 0)  # the same for every robot: it holds no array


class FrameReader(Generic[Message]):
    """Reads messages of a kind and lines of text from bytes: telemetry on the host, commands on the robot.

    It buffers at most one frame and one line.
    """

    def __init__(self, kind: type[Message], joints: int):
        self._kind, self._joints, self._framing = kind, joints, _FRAMINGS[kind]
        self._buffer, self._line = bytearray(), b""
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
        framing, buffer = self._framing, self._buffer
        at = buffer.find(framing.start)
        if at > 0:
            self._skip(at, out)
            return True
        if at < 0:  # the last bytes may become a start
            may_start = next((n for n in range(len(framing.start) - 1, 0, -1) if buffer.endswith(framing.start[:n])), 0)
            self._skip(len(buffer) - may_start, out)
            return False
        head = len(framing.start) + framing.length_bytes
        if len(buffer) < head:
            return False
        length = int.from_bytes(buffer[len(framing.start) : head], "big")
        total = head + length + len(framing.end)
        if not 0 < length <= MAX_PAYLOAD[self._kind] or (len(buffer) > head and not _begins_map(buffer[head])):
            self._reject(out)
            return True
        if len(buffer) < total:
            return False
        try:
            if buffer[total - len(framing.end) : total] != framing.end:
                raise ProtocolError("the end of the frame is missing")
            out.append(decode(bytes(buffer[head : head + length]), self._kind, self._joints))
            del buffer[:total]
        except ProtocolError:
            self._reject(out)
        return True

    def _reject(self, out: list[Message | str]) -> None:
        self.rejected += 1
        self._skip(1, out)

    def _skip(self, count: int, out: list[Message | str]) -> None:
        """Remove bytes outside frames; they are text if printable and ended by a line feed."""
        *lines, rest = (self._line + self._buffer[:count]).split(b"\n")
        del self._buffer[:count]
        self._line = rest[-MAX_LINE:]
        for line in lines:
            if text := _PRINTABLE_END.search(line[-MAX_LINE:].rstrip(b"\r")):
                out.append(text.group().decode("ascii").strip())


def _begins_map(byte: int) -> bool:
    """Whether a msgpack map can begin with this byte."""
    return 0x80 <= byte <= 0x8F or byte in (0xDE, 0xDF)
