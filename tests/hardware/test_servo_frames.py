"""Frames of the servo protocols, against examples of the makers' pages and their own rules."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motorprior.hardware.buses.frames import (
    DYNAMIXEL_FORMAT,
    FEETECH_FORMAT,
    PING,
    READ,
    WRITE,
    DynamixelFormat,
    FeetechFormat,
    Instruction,
)

FORMATS = [FEETECH_FORMAT, DYNAMIXEL_FORMAT]
# bytes that are likely to look like headers and stuffing
awkward = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01]), max_size=20).map(bytes)
instructions = st.builds(Instruction, st.integers(0, 252), st.integers(1, 3), awkward)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        # ROBOTIS e-Manual, Protocol 2.0: ping, and a goal position of 512
        (DYNAMIXEL_FORMAT.instruction(1, PING, b""), "ff ff fd 00 01 03 00 01 19 4e"),
        (
            DYNAMIXEL_FORMAT.instruction(1, WRITE, bytes([0x74, 0, 0, 2, 0, 0])),
            "ff ff fd 00 01 09 00 03 74 00 00 02 00 00 ca 89",
        ),
        # Feetech, communication protocol: ping, and a reading of the position
        (FEETECH_FORMAT.instruction(1, PING, b""), "ff ff 01 02 01 fb"),
        (FEETECH_FORMAT.instruction(1, READ, bytes([0x38, 2])), "ff ff 01 04 02 38 02 be"),
    ],
)
def test_frames_are_those_of_the_makers_pages(frame: bytes, text: str):
    assert frame.hex(" ") == text


@pytest.mark.parametrize("format", FORMATS)
@given(messages=st.lists(instructions, min_size=1, max_size=4), cut=st.integers(1, 30))
def test_instructions_survive_any_cuts(
    format: FeetechFormat | DynamixelFormat, messages: list[Instruction], cut: int
):
    stream = b"".join(format.instruction(*message) for message in messages)
    buffer = bytearray()
    decoded: list[Instruction] = []

    for start in range(0, len(stream), cut):
        buffer += stream[start : start + cut]
        decoded += format.instructions(buffer)

    assert decoded == messages
    assert not buffer


@pytest.mark.parametrize("format", FORMATS)
@given(data=st.data())
def test_a_damaged_byte_is_noticed_and_the_next_frame_is_read(
    format: FeetechFormat | DynamixelFormat, data: st.DataObject
):
    damaged = bytearray(format.instruction(3, WRITE, bytes([40, 0, 1, 2, 3])))
    place = data.draw(st.integers(7, len(damaged) - 1))
    damaged[place] ^= data.draw(st.integers(1, 255))
    whole = Instruction(5, READ, bytes([56, 0, 2, 0]))
    stream = bytearray(damaged) + format.instruction(*whole)

    decoded = list(format.instructions(stream))

    assert decoded in ([whole], [])
    if not decoded:  # the damage looks like the beginning of a longer frame
        stream += format.instruction(*whole) * 20
        assert whole in list(format.instructions(stream))
