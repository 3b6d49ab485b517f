"""From any bytes, however they are cut, come only frames and lines, and memory stays bounded."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.hardware.framing import (
    COMMAND_FRAMING,
    MAX_LINE,
    TELEMETRY_FRAMING,
    FrameReader,
    command_frame,
    command_reader,
    telemetry_frame,
    telemetry_reader,
)
from motorprior.hardware.protocol import IDLE, Command, Telemetry, encode_command, encode_telemetry

JOINTS = 12
READERS = {"command": lambda: command_reader(JOINTS), "telemetry": lambda: telemetry_reader(JOINTS)}
MOST_KEPT = max(framing.max_payload for framing in (COMMAND_FRAMING, TELEMETRY_FRAMING)) + 8 + MAX_LINE


def telemetry(ts: int) -> Telemetry:
    rates = dict.fromkeys(("yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.1)
    return Telemetry(ts=ts, **rates, pos=np.linspace(-1.0, 1.0, 12) + 0.01 * ts, vel=np.zeros(12))


def target(step: int) -> Command:
    return Command(pos=np.linspace(-1.0, 1.0, 12) + 0.01 * step, kp=50.0, kd=5.0, max_current=7.0)


def framed(message: Command | Telemetry) -> bytes:
    return telemetry_frame(message, JOINTS) if isinstance(message, Telemetry) else command_frame(message, JOINTS)


def as_bytes(message) -> bytes | str:
    if isinstance(message, str):
        return message
    return encode_telemetry(message, JOINTS) if isinstance(message, Telemetry) else encode_command(message, JOINTS)


def read(reader: FrameReader, pieces: list[bytes]) -> list[bytes | str]:
    return [as_bytes(message) for piece in pieces for message in reader.feed(piece)]


def cut(data: bytes, at: list[int]) -> list[bytes]:
    bounds = sorted({0, len(data), *(place % (len(data) + 1) for place in at)})
    return [data[a:b] for a, b in pairwise(bounds)]


good = st.integers(0, 9).flatmap(lambda n: st.sampled_from([framed(telemetry(n)), framed(target(n)), framed(IDLE)]))
noise = st.one_of(
    st.binary(max_size=40), st.sampled_from([b"ERROR\r\n", b"EE", b"\x45", b"\x00", b"SPEED\r\n", b"EE\x00\x10\x8f"])
)
damaged = st.tuples(good, st.integers(0, 400), st.integers(0, 255)).map(
    lambda parts: parts[0][: parts[1]] + bytes([parts[2]]) + parts[0][parts[1] + 1 :]
)
streams = st.lists(st.one_of(good, noise, damaged), max_size=12).map(b"".join)


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
    rng, reader, sent, found, size = np.random.default_rng(7), READERS[kind](), [], [], 0
    make: Callable = target if kind == "command" else telemetry
    while size < 1_000_000:
        junk = rng.integers(0, 256, int(rng.integers(1, 4000)), dtype=np.uint8)
        if rng.random() < 0.5:  # starts of frames everywhere
            junk[rng.integers(0, len(junk), 1 + len(junk) // 8)] = 0 if kind == "command" else 0x45
        message = make(len(sent))
        # What a false start at the end of the noise may swallow is at most one frame long: pad with text.
        piece = junk.tobytes() + b"\n" * 1100 + framed(message)
        sent.append(as_bytes(message))
        size += len(piece)
        found += [as_bytes(m) for m in reader.feed(piece) if not isinstance(m, str)]
        assert reader.pending <= MOST_KEPT
    assert len(sent) > 200
    assert [message for message in found if message in set(sent)] == sent


def test_text_between_frames_is_read_and_costs_no_frame():
    reader = telemetry_reader(JOINTS)
    stream = b"Homing\r\n" + framed(telemetry(1)) + b"ERROR\r\n" + b"FEET OK\r\n" + framed(telemetry(2))
    assert read(reader, [stream]) == [
        "Homing", encode_telemetry(telemetry(1), JOINTS), "ERROR", "FEET OK", encode_telemetry(telemetry(2), JOINTS),
    ]  # fmt: skip


@pytest.mark.parametrize("place", range(0, 4))
def test_a_damaged_head_costs_one_frame_only(place: int):
    """Also a length that became longer: the frames it would swallow are found again."""
    frame = framed(telemetry(0))
    broken = bytearray(frame)
    broken[place] ^= 0x03
    reader = telemetry_reader(JOINTS)
    found = read(reader, [bytes(broken), *(framed(telemetry(n)) for n in range(1, 8))])
    assert found == [encode_telemetry(telemetry(n), JOINTS) for n in range(1, 8)]


def test_a_robot_hears_idle_after_half_a_command():
    """What a host leaves when it is killed within a write, and then the watchdog's idle frames."""
    frame = framed(target(0))
    for length in range(len(frame)):
        heard = [message for message in command_reader(JOINTS).feed(frame[:length] + 40 * framed(IDLE))]
        assert any(isinstance(message, Command) and message.idle for message in heard), length
