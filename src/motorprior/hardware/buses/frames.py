"""Frames of two servo protocols, from the makers' protocol pages.

Feetech (FT-SCS, framing of Dynamixel Protocol 1.0; two-byte values of STS servos little-endian):

    FF FF  id  length  instruction or error  parameters  checksum
    length = parameters + 2,  checksum = ~(id + length + instruction + Σ parameters) mod 256

Dynamixel Protocol 2.0 (emanual.robotis.com/docs/en/dxl/protocol2):

    FF FF FD 00  id  length (2)  instruction  parameters  CRC (2)
    length = parameters + 3; a status has the instruction 55 and then its error

There FF FF FD in instruction and parameters becomes FF FF FD FD, and the CRC is CRC-16 with the
polynomial 8005 and the initial value 0, over all bytes before it.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

BROADCAST = 0xFE
PING = 0x01
READ = 0x02
WRITE = 0x03
SYNC_READ = 0x82
SYNC_WRITE = 0x83
FAST_SYNC_READ = 0x8A  # Dynamixel Protocol 2.0 only
STATUS = 0x55
_POLYNOMIAL = 0x8005
_FEETECH_HEADER = b"\xff\xff"
_DYNAMIXEL_HEADER = b"\xff\xff\xfd\x00"
_PATTERN = b"\xff\xff\xfd"  # stuffed with another FD
# longest plausible frame [bytes]; a damaged length must not block the reader
_MAX_LENGTH = 512


class Instruction(NamedTuple):
    """An instruction of the host."""

    servo: int  # id, or BROADCAST
    code: int
    parameters: bytes


class FrameFormat(Protocol):
    """Encodes frames, and decodes the instructions in a stream of bytes."""

    def instruction(self, servo: int, code: int, parameters: bytes) -> bytes:
        """The frame of an instruction."""
        ...

    def status(self, servo: int, error: int, parameters: bytes) -> bytes:
        """The frame of a servo's answer."""
        ...

    def sync_write(self, servos: Sequence[int], address: int, data: Sequence[bytes]) -> bytes:
        """The frame that writes equally long data to several servos."""
        ...

    def instructions(self, buffer: bytearray) -> Iterator[Instruction]:
        """Decode and remove the complete instructions; damaged bytes are skipped."""
        ...


class FeetechFormat:
    """Feetech's frames."""

    def instruction(self, servo: int, code: int, parameters: bytes) -> bytes:
        """See `FrameFormat`."""
        content = bytes([servo, len(parameters) + 2, code]) + parameters
        return _FEETECH_HEADER + content + bytes([checksum(content)])

    def status(self, servo: int, error: int, parameters: bytes) -> bytes:
        """See `FrameFormat`."""
        return self.instruction(servo, error, parameters)

    def sync_write(self, servos: Sequence[int], address: int, data: Sequence[bytes]) -> bytes:
        """See `FrameFormat`."""
        content = bytes([address, len(data[0])])
        for servo, values in zip(servos, data, strict=True):
            content += bytes([servo]) + values
        return self.instruction(BROADCAST, SYNC_WRITE, content)

    def instructions(self, buffer: bytearray) -> Iterator[Instruction]:
        """See `FrameFormat`."""
        while _begins_with(buffer, _FEETECH_HEADER, 4):
            length = buffer[3]
            end = 4 + length
            if length < 2:
                del buffer[0]
                continue
            if len(buffer) < end:
                return
            if checksum(buffer[2 : end - 1]) != buffer[end - 1]:
                del buffer[0]
                continue
            frame = bytes(buffer[:end])
            del buffer[:end]
            yield Instruction(frame[2], frame[4], frame[5:-1])


class DynamixelFormat:
    """Frames of Dynamixel Protocol 2.0."""

    def instruction(self, servo: int, code: int, parameters: bytes) -> bytes:
        """See `FrameFormat`."""
        content = stuffed(bytes([code]) + parameters)
        length = len(content) + 2
        frame = _DYNAMIXEL_HEADER + bytes([servo]) + length.to_bytes(2, "little") + content
        return frame + crc16(frame).to_bytes(2, "little")

    def status(self, servo: int, error: int, parameters: bytes) -> bytes:
        """See `FrameFormat`."""
        return self.instruction(servo, STATUS, bytes([error]) + parameters)

    def fast_status(self, answers: Sequence[tuple[int, int, bytes]]) -> bytes:
        """The joint answer to a fast sync read, from (id, error, data) of each servo.

        Each servo adds its error, id, data and the CRC of everything before; the last CRC is the
        frame's own.
        """
        length = sum(len(data) + 4 for _, _, data in answers) + 1
        frame = _DYNAMIXEL_HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little")
        frame += bytes([STATUS])
        for servo, error, data in answers:
            frame += bytes([error, servo]) + data
            frame += crc16(frame).to_bytes(2, "little")
        return frame

    def sync_write(self, servos: Sequence[int], address: int, data: Sequence[bytes]) -> bytes:
        """See `FrameFormat`."""
        content = address.to_bytes(2, "little") + len(data[0]).to_bytes(2, "little")
        for servo, values in zip(servos, data, strict=True):
            content += bytes([servo]) + values
        return self.instruction(BROADCAST, SYNC_WRITE, content)

    def instructions(self, buffer: bytearray) -> Iterator[Instruction]:
        """See `FrameFormat`."""
        while _begins_with(buffer, _DYNAMIXEL_HEADER, 7):
            length = int.from_bytes(buffer[5:7], "little")
            end = 7 + length
            if not 3 <= length <= _MAX_LENGTH:
                del buffer[0]
                continue
            if len(buffer) < end:
                return
            if crc16(buffer[: end - 2]) != int.from_bytes(buffer[end - 2 : end], "little"):
                del buffer[0]
                continue
            frame = bytes(buffer[:end])
            del buffer[:end]
            content = unstuffed(frame[7:-2])
            yield Instruction(frame[4], content[0], content[1:])


def _begins_with(buffer: bytearray, header: bytes, min_length: int) -> bool:
    """Remove bytes before the next header; whether ``min_length`` bytes are there."""
    start = buffer.find(header)
    if start < 0:
        # the end may be the beginning of a header
        del buffer[: max(0, len(buffer) - len(header) + 1)]
        return False
    del buffer[:start]
    return len(buffer) >= min_length


def checksum(content: bytes | bytearray) -> int:
    """Feetech's checksum of everything between header and checksum."""
    return ~sum(content) & 0xFF


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (_POLYNOMIAL if value & 0x8000 else 0)
        table.append(value & 0xFFFF)
    return table


_CRC_TABLE = _crc_table()


def crc16(data: bytes | bytearray) -> int:
    """CRC-16 of Dynamixel Protocol 2.0."""
    value = 0
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ _CRC_TABLE[(value >> 8) ^ byte]
    return value


def stuffed(content: bytes) -> bytes:
    """Instruction and parameters with byte stuffing."""
    return content.replace(_PATTERN, _PATTERN + b"\xfd")


def unstuffed(content: bytes) -> bytes:
    """The inverse of `stuffed`."""
    return content.replace(_PATTERN + b"\xfd", _PATTERN)


FEETECH_FORMAT = FeetechFormat()
DYNAMIXEL_FORMAT = DynamixelFormat()
