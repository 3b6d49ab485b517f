"""Any bytes, however they are cut, give only frames and lines, and memory stays bounded."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telemetry import telemetry

from motorprior.hardware.protocol import IDLE, MAX_LINE, MAX_PAYLOAD, Command, FrameReader, Telemetry, encode, framed

JOINTS = 12
READERS = {"command": lambda: FrameReader(Command, JOINTS), "telemetry": lambda: FrameReader(Telemetry, JOINTS)}
MAX_BUFFERED = max(MAX_PAYLOAD.values()) + 8 + MAX_LINE


def measured(ts: int) -> bytes:
    return framed(telemetry(ts=ts, yaw=0.1, pos=np.linspace(-1.0, 1.0, 12) + 0.01 * ts), JOINTS)


def target(step: int) -> bytes:
    return framed(Command(pos=np.linspace(-1.0, 1.0, 12) + 0.01 * step, kp=50.0), JOINTS)


def read(reader: FrameReader, pieces: list[bytes]) -> list[bytes | str]:
    """Lines, and payloads of messages."""
    messages = [message for piece in pieces for message in reader.feed(piece)]
    return [message if isinstance(message, str) else encode(message, JOINTS) for message in messages]


def payloads(frames: list[bytes]) -> list[bytes | str]:
    return [payload for frame in frames for payload in read(FrameReader(Telemetry, JOINTS), [frame])]


def cut(data: bytes, at: list[int]) -> list[bytes]:
    bounds = sorted({0, len(data), *(place % (len(data) + 1) for place in at)})
    return [data[a:b] for a, b in pairwise(bounds)]


good = st.integers(0, 9).flatmap(lambda n: st.sampled_from([measured(n), target(n), framed(IDLE, JOINTS)]))
noise = st.one_of(
    st.binary(max_size=40), st.sampled_from([b"ERROR\r\n", b"EE", b"\x45", b"\x00", b"SPEED\r\n", b"EE\x00\x10\x8f"])
)
damaged = st.tuples(good, st.integers(0, 400), st.integers(0, 255)).map(
    lambda parts: parts[0][: parts[1]] + bytes([parts[2]]) + parts[0][parts[1] + 1 :]
)
streams = st.lists(st.one_of(good, noise, damaged, st.just(b"long " * 70)), max_size=12).map(b"".join)


@pytest.mark.parametrize("kind", READERS)
@given(data=streams, at=st.lists(st.integers(0, 10**6), max_size=12))
@settings(max_examples=150, deadline=None)
def test_the_same_messages_however_the_stream_is_cut(kind: str, data: bytes, at: list[int]):
    whole = read(READERS[kind](), [data])
    assert read(READERS[kind](), cut(data, at)) == whole
    assert read(READERS[kind](), [bytes([byte]) for byte in data]) == whole


@pytest.mark.parametrize("kind", READERS)
def test_a_million_bytes_of_noise_with_frames_in_them(kind: str):
    """No exception, bounded memory, and the frames between the noise are found."""
    rng, reader, sent, received, size = np.random.default_rng(7), READERS[kind](), [], [], 0
    make: Callable[[int], bytes] = target if kind == "command" else measured
    while size < 1_000_000:
        junk = rng.integers(0, 256, int(rng.integers(1, 4000)), dtype=np.uint8)
        if rng.random() < 0.5:  # starts of frames everywhere
            junk[rng.integers(0, len(junk), 1 + len(junk) // 8)] = 0 if kind == "command" else 0x45
        # A false start at the end of the noise may swallow at most one frame: pad with text.
        frame = make(len(sent))
        piece = junk.tobytes() + b"\n" * 1100 + frame
        sent += read(READERS[kind](), [frame])
        size += len(piece)
        received += read(reader, [piece])
        assert len(reader._buffer) + len(reader._line) <= MAX_BUFFERED
    assert len(sent) > 200
    assert [message for message in received if message in set(sent)] == sent


def test_text_between_frames_is_read_and_costs_no_frame():
    stream = b"Homing\r\n" + measured(1) + b"ERROR\r\n" + b"FEET OK\r\n" + measured(2)
    one, two = payloads([measured(1), measured(2)])
    assert read(FrameReader(Telemetry, JOINTS), [stream]) == ["Homing", one, "ERROR", "FEET OK", two]


@pytest.mark.parametrize("place", range(0, 4))
def test_a_damaged_head_costs_one_frame_only(place: int):
    """Also a length that became longer: the frames it would swallow are found again."""
    broken, intact = bytearray(measured(0)), [measured(n) for n in range(1, 8)]
    broken[place] ^= 0x03
    assert read(FrameReader(Telemetry, JOINTS), [bytes(broken), *intact]) == payloads(intact)


def test_a_robot_receives_idle_after_half_a_command():
    """What a host leaves when it is killed within a write, and then the watchdog's idle frames."""
    frame = target(0)
    for length in range(len(frame)):
        received = FrameReader(Command, JOINTS).feed(frame[:length] + 40 * framed(IDLE, JOINTS))
        assert any(isinstance(message, Command) and message.idle for message in received), length
