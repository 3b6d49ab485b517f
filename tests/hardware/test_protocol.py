"""Messages mean what they meant on the other side, and the encoder refuses what the firmware would."""

import struct

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import ProtocolError
from motorprior.hardware.framing import command_frame, telemetry_frame
from motorprior.hardware.protocol import (
    Command,
    Sizes,
    Telemetry,
    decode_command,
    decode_telemetry,
    encode_command,
    encode_telemetry,
)

SIZES = Sizes(12, 4)


def packed(value: object) -> bytes:
    made = msgpack.packb(value)
    assert made is not None
    return made


number = st.floats(-(2.0**100), 2.0**100, width=32)
array = st.lists(number, min_size=12, max_size=12).map(np.array)
triple = st.lists(number, min_size=3, max_size=3).map(np.array)
flag = st.booleans()
commands = st.one_of(
    st.builds(Command, pos=array, kp=number, kd=number, max_current=number, activations=array),
    st.builds(Command, cart_pos=array, cart_kp=triple, cart_kd=triple, ff_force=array),
    st.builds(Command, zero=flag, home=flag, idle=flag, debug=flag),
)
telemetries = st.builds(
    Telemetry,
    ts=st.integers(0, 2**32 - 1).map(float),
    **dict.fromkeys(("yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), number),
    pos=array,
    vel=array,
    **dict.fromkeys(("cur", "pref", "vref", "cref", "lcur", "temp"), st.none() | array),
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
    assert same(decode_command(encode_command(command, SIZES), SIZES), command)


@given(telemetries)
@settings(max_examples=100, deadline=None)
def test_telemetry_comes_back_as_it_was(telemetry: Telemetry):
    assert same(decode_telemetry(encode_telemetry(telemetry, SIZES), SIZES), telemetry)


def test_the_bytes_of_a_command_are_those_of_the_wire():
    frame = command_frame(Command(kp=50.0, idle=True), SIZES)
    # 0x00, length 15, a map of 2: "kp" as float32 50.0 big-endian, "idle" true
    assert frame == b"\x00\x0f\x82\xa2kp\xca" + struct.pack(">f", 50.0) + b"\xa4idle\xc3"


def test_the_bytes_of_telemetry_are_those_of_the_wire():
    frame = telemetry_frame(at_rest(ts=258.0, pos=np.full(12, 1.5)), SIZES)
    length = int.from_bytes(frame[2:4], "big")
    assert frame[:2] == b"\x45\x45" and frame[-2:] == b"\r\n" and len(frame) == 4 + length + 2
    found = msgpack.unpackb(frame[4:-2])
    assert found["ts"] == 258 and found["pos"] == [1.5] * 12
    assert frame.count(b"\xca\x3f\xc0\x00\x00") == 12, "float32"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (Command(pos=np.zeros(11)), "pos has 11 values, the firmware takes 12"),
        (Command(cart_kp=np.zeros(12)), "cart_kp has 12 values, the firmware takes 3"),
        (Command(pos=np.array([0.0] * 3 + [np.nan] + [0.0] * 8)), r"pos\[3\] is nan"),
        (Command(kp=float("inf")), "kp is inf"),
        (Command(kd=1e39), "kd is 1e\\+39, not a finite float32"),
        (Command(idle=1), "idle is 1, not true or false"),  # pyright: ignore[reportArgumentType]
        (Command(), "an empty command"),
        (Command(pos=np.ones(12), activations=np.ones(12), cart_pos=np.ones(12), ff_force=np.ones(12)), "takes 255"),
    ],
)
def test_what_the_firmware_would_refuse_is_not_encoded(command: Command, words: str):
    with pytest.raises(ProtocolError, match=words):
        encode_command(command, SIZES)


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
        decode_command(payload, SIZES)
    with pytest.raises(ProtocolError):
        decode_telemetry(payload, SIZES)
