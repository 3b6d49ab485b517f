"""Messages survive the wire, and invalid ones are rejected at both ends."""

import struct

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import ProtocolError
from motorprior.hardware.framing import command_frame
from motorprior.hardware.protocol import (
    Command,
    Telemetry,
    decode_command,
    decode_telemetry,
    encode_command,
    encode_telemetry,
)

JOINTS = 12


def packed(value: object) -> bytes:
    made = msgpack.packb(value)
    assert made is not None
    return made


number = st.floats(-(2.0**100), 2.0**100, width=32)
array = st.lists(number, min_size=12, max_size=12).map(np.array)
flag = st.booleans()
commands = st.one_of(
    st.builds(Command, pos=array, kp=number, kd=number, max_current=number),
    st.builds(Command, idle=flag),
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


def same(one: Command | Telemetry, other: Command | Telemetry) -> bool:
    return vars(one).keys() == vars(other).keys() and all(
        np.array_equal(value, vars(other)[name]) for name, value in vars(one).items()
    )


def at_rest(**changes) -> Telemetry:
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    return Telemetry(**{**zeros, "pos": np.zeros(12), "vel": np.zeros(12), **changes})


@given(commands)
@settings(max_examples=100, deadline=None)
def test_a_command_comes_back_as_it_was(command: Command):
    assert same(decode_command(encode_command(command, JOINTS), JOINTS), command)


@given(telemetries)
@settings(max_examples=100, deadline=None)
def test_telemetry_comes_back_as_it_was(telemetry: Telemetry):
    assert same(decode_telemetry(encode_telemetry(telemetry, JOINTS), JOINTS), telemetry)


def test_the_bytes_of_a_command_are_those_of_the_wire():
    frame = command_frame(Command(kp=50.0, idle=True), JOINTS)
    # 0x00, length 15, a map of 2: "kp" as float32 50.0 big-endian, "idle" true
    assert frame == b"\x00\x0f\x82\xa2kp\xca" + struct.pack(">f", 50.0) + b"\xa4idle\xc3"


@pytest.mark.parametrize(
    "command",
    [
        Command(pos=np.zeros(11)),
        Command(pos=np.array([0.0] * 3 + [np.nan] + [0.0] * 8)),
        Command(kp=float("inf")),
        Command(kd=1e39),
        Command(),
    ],
)
def test_an_invalid_command_is_not_encoded(command: Command):
    with pytest.raises(ProtocolError):
        encode_command(command, JOINTS)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x80",
        b"\xc1",
        b"\x91\x01",
        packed({"kp": "much"}),
        packed({"speed": 1.0}),
        packed({"kp": float("nan")}),
        packed({"pos": [0.0] * 13}),
        packed({"pos": [True] * 12}),
        packed({"idle": True}) + b"\x00",
        b"\x81" + b"\x91" * 200,
        b"\xdf\xff\xff\xff\xff",
    ],
    ids=repr,
)
def test_a_payload_that_makes_no_sense_is_an_error_and_nothing_else(payload: bytes):
    with pytest.raises(ProtocolError):
        decode_command(payload, JOINTS)
    with pytest.raises(ProtocolError):
        decode_telemetry(payload, JOINTS)
