"""Messages survive the wire, and invalid ones are rejected at both ends."""

import struct

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import ProtocolError
from motorprior.hardware.protocol import Command, Telemetry, decode, encode, framed

JOINTS = 12
number = st.floats(-(2.0**100), 2.0**100, width=32)
array = st.lists(number, min_size=12, max_size=12).map(np.array)
commands = st.one_of(
    st.builds(Command, pos=array, kp=number, kd=number, max_current=number), st.builds(Command, idle=st.booleans())
)
telemetries = st.builds(
    Telemetry,
    ts=st.integers(0, 2**32 - 1).map(float),
    **dict.fromkeys(("yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), number),
    pos=array,
    vel=array,
    **dict.fromkeys(("cur", "temp"), st.none() | array),
    bat=st.none() | number,
)


@given(st.one_of(commands, telemetries))
@settings(max_examples=150, deadline=None)
def test_a_message_is_decoded_as_it_was_sent(message: Command | Telemetry):
    received = decode(encode(message, JOINTS), type(message), JOINTS)
    assert type(received) is type(message)
    assert all(np.array_equal(value, vars(received)[name]) for name, value in vars(message).items())


def test_the_bytes_of_a_command_are_those_of_the_wire():
    frame = framed(Command(kp=50.0, idle=True), JOINTS)
    # 0x00, length 15, a map of 2: "kp" as float32 50.0 big-endian, "idle" true
    assert frame == b"\x00\x0f\x82\xa2kp\xca" + struct.pack(">f", 50.0) + b"\xa4idle\xc3"


@pytest.mark.parametrize(
    "command",
    [
        Command(pos=np.zeros(11)),
        Command(pos=np.full(12, np.nan)),
        Command(kp=float("inf")),
        Command(kd=1e39),
        Command(),
    ],
)
def test_an_invalid_command_is_not_encoded(command: Command):
    with pytest.raises(ProtocolError):
        encode(command, JOINTS)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x80",
        b"\xc1",
        b"\x91\x01",
        msgpack.packb({"kp": "much"}),
        msgpack.packb({"speed": 1.0}),
        msgpack.packb({"kp": float("nan")}),
        msgpack.packb({"pos": [0.0] * 13}),
        msgpack.packb({"pos": [True] * 12}),
        b"\x81\xa4idle\xc3\x00",
        b"\x81" + b"\x91" * 200,
        b"\xdf\xff\xff\xff\xff",
    ],
    ids=repr,
)
def test_an_invalid_payload_is_a_protocol_error(payload: bytes):
    for kind in (Command, Telemetry):
        with pytest.raises(ProtocolError):
            decode(payload, kind, JOINTS)
