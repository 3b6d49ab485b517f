"""Frames in a stream of bytes: where they begin and end, and finding them again after noise.

    host to robot   0x00, one length byte, payload
    robot to host   0x45 0x45, length as 16 bit big-endian, payload, CR LF; lines of plain text in between

There is no checksum. A frame counts if its length is possible, its end is where it must be and its payload makes
sense; otherwise one byte is passed over and the search goes on. Whether a byte belongs to a frame depends on the
bytes alone, never on how the stream was cut.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from motorprior.exceptions import ProtocolError
from motorprior.hardware.protocol import (
    IDLE,
    LARGEST_COMMAND,
    LARGEST_TELEMETRY,
    Command,
    Sizes,
    Telemetry,
    decode_command,
    decode_telemetry,
    encode_command,
    encode_telemetry,
)

LONGEST_LINE = 256
"""A line of text is cut there [bytes]."""
_PRINTABLE_END = re.compile(rb"[\x20-\x7e\t]{4,}$")
Message = TypeVar("Message")


@dataclass(frozen=True)
class Framing:
    """How a payload is wrapped.

    Attributes:
        start: bytes before the length.
        length_bytes: size of the length, big-endian.
        end: bytes after the payload.
        largest: longest payload [bytes].
    """

    start: bytes
    length_bytes: int
    end: bytes
    largest: int

    def wrap(self, payload: bytes) -> bytes:
        """A frame."""
        return self.start + len(payload).to_bytes(self.length_bytes, "big") + payload + self.end


COMMAND_FRAMING = Framing(b"\x00", 1, b"", LARGEST_COMMAND)
TELEMETRY_FRAMING = Framing(b"\x45\x45", 2, b"\r\n", LARGEST_TELEMETRY)


def command_frame(command: Command, sizes: Sizes) -> bytes:
    """A command as it goes over the wire; raises what `encode_command` raises."""
    return COMMAND_FRAMING.wrap(encode_command(command, sizes))


def telemetry_frame(telemetry: Telemetry, sizes: Sizes) -> bytes:
    """Telemetry as it goes over the wire; raises what `encode_telemetry` raises."""
    return TELEMETRY_FRAMING.wrap(encode_telemetry(telemetry, sizes))


IDLE_FRAME = command_frame(IDLE, Sizes(0, 0))
"""The same bytes for every robot: the command holds no array."""


class FrameReader(Generic[Message]):
    """Bytes in, messages and lines of text out. Keeps at most one frame and one line.

    Args:
        framing: how payloads are wrapped.
        decode: payload to message; a ProtocolError means that this was no frame.
    """

    def __init__(self, framing: Framing, decode: Callable[[bytes], Message]):
        self._framing, self._decode = framing, decode
        self._buffer, self._line = bytearray(), bytearray()
        self.rejected = 0
        """Starts of frames that were none: damaged frames, and chance."""

    def feed(self, data: bytes) -> list[Message | str]:
        """Messages and lines that ``data`` completes, in order."""
        self._buffer += data
        out: list[Message | str] = []
        while self._advance(out):
            pass
        return out

    @property
    def pending(self) -> int:
        """Bytes kept for later."""
        return len(self._buffer) + len(self._line)

    def _advance(self, out: list[Message | str]) -> bool:
        """Take one step; False when more bytes are needed."""
        framing, buffer = self._framing, self._buffer
        at = buffer.find(framing.start)
        if at != 0:
            keep = 0 if at > 0 else _prefix_length(buffer, framing.start)
            self._pass_over(at if at > 0 else len(buffer) - keep, out)
            return at > 0
        head = len(framing.start) + framing.length_bytes
        if len(buffer) < head:
            return False
        length = int.from_bytes(buffer[len(framing.start) : head], "big")
        total = head + length + len(framing.end)
        if not 0 < length <= framing.largest or (len(buffer) > head and not _begins_map(buffer[head])):
            self._reject(out)
            return True
        if len(buffer) < total:
            return False
        try:
            if buffer[total - len(framing.end) : total] != framing.end:
                raise ProtocolError("the end of the frame is missing")
            out.append(self._decode(bytes(buffer[head : head + length])))
            del buffer[:total]
        except ProtocolError:
            self._reject(out)
        return True

    def _reject(self, out: list[Message | str]) -> None:
        self.rejected += 1
        self._pass_over(1, out)

    def _pass_over(self, count: int, out: list[Message | str]) -> None:
        """Take bytes that are in no frame: text, if they are printable and end in a line feed."""
        *lines, rest = bytes(self._buffer[:count]).split(b"\n")
        del self._buffer[:count]
        for line in lines:
            self._extend_line(line, out)
            self._end_line(out)
        self._extend_line(rest, out)

    def _extend_line(self, piece: bytes, out: list[Message | str]) -> None:
        self._line += piece
        while len(self._line) > LONGEST_LINE:
            head, self._line = self._line[:LONGEST_LINE], self._line[LONGEST_LINE:]
            _append_text(bytes(head), out)

    def _end_line(self, out: list[Message | str]) -> None:
        _append_text(bytes(self._line), out)
        self._line.clear()


def command_reader(sizes: Sizes) -> FrameReader[Command]:
    """The robot's end of the line: reads commands."""
    return FrameReader(COMMAND_FRAMING, lambda payload: decode_command(payload, sizes))


def telemetry_reader(sizes: Sizes) -> FrameReader[Telemetry]:
    """The host's end of the line: reads telemetry and text."""
    return FrameReader(TELEMETRY_FRAMING, lambda payload: decode_telemetry(payload, sizes))


def _append_text(line: bytes, out: list) -> None:
    """The printable end of a line: what stands before it may be the rest of a damaged frame."""
    found = _PRINTABLE_END.search(line.rstrip(b"\r"))
    if found:
        out.append(found.group().decode("ascii").strip())


def _begins_map(byte: int) -> bool:
    """Whether a msgpack map can begin with this byte."""
    return 0x80 <= byte <= 0x8F or byte in (0xDE, 0xDF)


def _prefix_length(buffer: bytearray, start: bytes) -> int:
    """Length of the end of ``buffer`` that may become ``start``."""
    return next((n for n in range(len(start) - 1, 0, -1) if buffer.endswith(start[:n])), 0)
