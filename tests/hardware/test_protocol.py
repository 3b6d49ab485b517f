"""Messages survive the wire; any bytes give the same frames and lines however they are cut."""

import struct
from itertools import pairwise

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telemetry import telemetry

from motorprior.exceptions import ProtocolError
from motorprior.hardware.health import TelemetryStream
from motorprior.hardware.protocol import (
    IDLE,
    IDLE_FRAME,
    Command,
    FrameReader,
    Telemetry,
    decode_message,
    encode_message,
    framed,
)
from motorprior.robots.pupper_v2.robot import PUPPER_V2

JOINTS = 12
number = st.floats(-(2.0**100), 2.0**100, width=32)
array = st.lists(number, min_size=12, max_size=12).map(np.array)
commands = st.one_of(
    st.builds(Command, pos=array, kp=number, kd=number, max_current=number),
    st.builds(Command, idle=st.booleans()),
)
telemetries = st.builds(
    Telemetry,
    ts=st.integers(0, 2**32 - 1).map(float),
    yaw=number,
    pitch=number,
    roll=number,
    yaw_rate=number,
    pitch_rate=number,
    roll_rate=number,
    pos=array,
    vel=array,
    cur=st.none() | array,
)


@given(st.one_of(commands, telemetries))
@settings(max_examples=100, deadline=None)
def test_a_message_is_decoded_as_it_was_sent(message: Command | Telemetry):
    received = decode_message(encode_message(message, JOINTS), type(message), JOINTS)

    assert type(received) is type(message)
    for name, value in vars(message).items():
        assert np.array_equal(value, vars(received)[name]), name


def test_the_bytes_of_a_command_are_those_of_the_wire():
    frame = framed(Command(kp=50.0, idle=True), JOINTS)
    # 0x00, length 15, a map of 2: "kp" as float32 50.0 big-endian, "idle" true
    assert frame == b"\x00\x0f\x82\xa2kp\xca" + struct.pack(">f", 50.0) + b"\xa4idle\xc3"


@pytest.mark.parametrize(
    "command",
    [Command(pos=np.zeros(11)), Command(pos=np.full(12, np.nan)), Command(kd=1e39), Command()],
    ids=repr,
)
def test_an_invalid_command_is_not_encoded(command: Command):
    with pytest.raises(ProtocolError):
        encode_message(command, JOINTS)


NO_MAPS = [
    b"",
    b"\x80",
    b"\xc1",
    b"\x91\x01",
    b"\x81\xa4idle\xc3\x00",
    b"\x81" + b"\x91" * 200,
    b"\xdf" + b"\xff" * 4,
]
MAPS = [
    {"kp": "much"},
    {"speed": 1.0},
    {"kp": float("nan")},
    {"pos": [0.0] * 13},
    {"pos": [True] * 12},
]


@pytest.mark.parametrize("payload", [*NO_MAPS, *map(msgpack.packb, MAPS)], ids=repr)
def test_an_invalid_payload_is_a_protocol_error(payload: bytes):
    for message_type in (Command, Telemetry):
        with pytest.raises(ProtocolError):
            decode_message(payload, message_type, JOINTS)


def measured(ts: int) -> bytes:
    """Frame of telemetry."""
    return framed(telemetry(ts=ts, yaw=0.1, pos=np.linspace(-1.0, 1.0, 12) + 0.01 * ts), JOINTS)


def target(step: int) -> bytes:
    """Frame of a command."""
    return framed(Command(pos=np.linspace(-1.0, 1.0, 12) + 0.01 * step, kp=50.0), JOINTS)


def read(message_type: type, chunks: list[bytes]) -> list[bytes | str]:
    """Lines and payloads of messages in a stream that arrives in chunks."""
    reader = FrameReader(message_type, JOINTS)
    received = []
    for chunk in chunks:
        for message in reader.feed(chunk):
            is_line = isinstance(message, str)
            received.append(message if is_line else encode_message(message, JOINTS))
    return received


def with_byte(frame: bytes, index: int, byte: int) -> bytes:
    """The frame with another byte, or one byte more at its end."""
    return frame[:index] + bytes([byte]) + frame[index + 1 :]


NOISE = [b"ERROR\r\n", b"EE", b"\x45", b"\x00", b"EE\x00\x10\x8f"]
good = st.integers(0, 9).flatmap(lambda n: st.sampled_from([measured(n), target(n), IDLE_FRAME]))
noise = st.binary(max_size=40) | st.sampled_from(NOISE)
damaged = st.builds(with_byte, good, st.integers(0, 400), st.integers(0, 255))
long_text = st.just(b"long " * 70)
streams = st.lists(st.one_of(good, noise, damaged, long_text), max_size=12).map(b"".join)


@pytest.mark.parametrize("message_type", [Command, Telemetry])
@given(stream=streams, cuts=st.lists(st.integers(0, 10**6), max_size=12))
@settings(max_examples=100, deadline=None)
def test_a_stream_has_the_same_messages_however_it_is_cut(
    message_type: type, stream: bytes, cuts: list[int]
):
    whole = read(message_type, [stream])

    bounds = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    chunks = [stream[start:stop] for start, stop in pairwise(bounds)]
    assert read(message_type, chunks) == whole

    single_bytes = [bytes([byte]) for byte in stream]
    assert read(message_type, single_bytes) == whole


def test_text_between_frames_is_read():
    (first,) = read(Telemetry, [measured(1)])
    (second,) = read(Telemetry, [measured(2)])
    stream = b"Homing\r\n" + measured(1) + b"ERROR\r\n" + b"FEET OK\r\n" + measured(2)
    assert read(Telemetry, [stream]) == ["Homing", first, "ERROR", "FEET OK", second]


@pytest.mark.parametrize("index", range(4))
def test_a_damaged_head_costs_one_frame_only(index: int):
    """A length that became longer does not swallow the next frames either."""
    frames = [measured(ts) for ts in range(1, 8)]
    payloads = read(Telemetry, frames)
    broken = bytearray(measured(0))
    broken[index] ^= 0x03

    received = read(Telemetry, [bytes(broken), *frames])

    assert len(payloads) == 7
    assert received[-7:] == payloads


def test_a_robot_receives_idle_after_half_a_command():
    """A host that is killed within a write leaves half a frame; the watchdog sends idle frames."""
    frame = target(0)
    for length in range(len(frame)):
        reader = FrameReader(Command, JOINTS)
        messages = reader.feed(frame[:length] + 40 * framed(IDLE, JOINTS))
        commands_read = [message for message in messages if isinstance(message, Command)]
        assert any(command.idle for command in commands_read), length


LIMITS = PUPPER_V2.require_wire().safety


def running() -> TelemetryStream:
    """Stream of 100 frames at 100 Hz, with 3 ms of transmission."""
    stream = TelemetryStream(LIMITS)
    for n in range(100):
        assert stream.accept(telemetry(ts=10.0 * n), 5.0 + 0.01 * n + 0.003) is not None
    return stream


def test_age_is_the_delay_beyond_the_shortest_transmission():
    late = running().accept(telemetry(ts=1000.0), 6.0 + 0.003 + 0.04)
    assert late is not None
    assert late.arrival - late.sampled == pytest.approx(0.04)


def test_a_damaged_time_stamp_does_not_make_later_frames_look_old():
    """25 ms ahead, which a real frame could be; the next two look overtaken."""
    stream = running()
    assert stream.accept(telemetry(ts=1025.0), 6.003) is not None

    assert stream.accept(telemetry(ts=1010.0), 6.013) is None
    assert stream.accept(telemetry(ts=1020.0), 6.023) is None
    assert stream.accept(telemetry(ts=1030.0), 6.033) is not None
    assert stream.repeated == 2

    later = stream.accept(telemetry(ts=1040.0), 6.043)
    assert later is not None
    assert later.arrival - later.sampled == pytest.approx(0.0)


def test_a_drifting_clock_is_followed():
    """The clock drifts by 300 ppm, which are 30 ms in 100 s."""
    stream = TelemetryStream(LIMITS)
    ages = []

    for n in range(10_000):
        measurement = stream.accept(telemetry(ts=round(10.0 * n * (1 - 3e-4))), 0.01 * n)
        if measurement is not None:
            ages.append(measurement.arrival - measurement.sampled)

    assert max(ages) < 0.006
    assert stream.impossible == 0


IMPOSSIBLE = [
    {"pos": np.eye(12)[3]},
    {"pos": np.full(12, 7.0)},
    {"vel": np.full(12, 1e6)},
    {"roll": 1.0},
    {"pitch_rate": 1e3},
    {"yaw": 1e9},
    {"ts": 1200.0},
    {"ts": 4e9},
]


@pytest.mark.parametrize("values", IMPOSSIBLE, ids=str)
def test_an_impossible_frame_is_not_accepted(values: dict):
    stream = running()
    frame = telemetry(**({"ts": 1000.0} | values))

    assert stream.accept(frame, 6.003) is None
    assert stream.impossible == 1

    following = stream.accept(telemetry(ts=1010.0), 6.013)
    assert following is not None
    age = following.arrival - following.sampled
    assert age == pytest.approx(0.0), "the clock offset is unchanged"
    assert stream.impossible_in_a_row == 0
