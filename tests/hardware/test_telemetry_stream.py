"""Which frames are accepted, and how old they are."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import check_stream
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.telemetry_stream import TelemetryStream
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WIRE = PUPPER_V2.require_wire()


def frame(ts: float, **values) -> Telemetry:
    zeros = dict.fromkeys(("yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    return Telemetry(**{**zeros, "ts": ts, "pos": np.zeros(12), "vel": np.zeros(12), **values})


def running(frames: int = 100) -> TelemetryStream:
    """100 Hz, 3 ms of transmission."""
    stream = TelemetryStream(WIRE.safety)
    for n in range(frames):
        assert stream.accept(frame(10.0 * n), 5.0 + 0.01 * n + 0.003) is not None
    return stream


def test_age_is_the_delay_beyond_the_shortest_transmission():
    stream = running()
    late = stream.accept(frame(1000.0), 6.0 + 0.003 + 0.04)
    assert late is not None and late.arrival - late.sampled == pytest.approx(0.04)


def test_a_damaged_time_stamp_does_not_make_later_frames_look_old():
    """25 ms ahead, which a real frame could be; the three that follow look overtaken."""
    stream = running()
    assert stream.accept(frame(1025.0), 6.003) is not None
    assert [stream.accept(frame(1000.0 + 10.0 * n), 6.003 + 0.01 * n) is None for n in (1, 2, 3)] == [True, True, False]
    later = stream.accept(frame(1040.0), 6.043)
    assert later is not None and later.arrival - later.sampled == pytest.approx(0.0)


def test_a_drifting_clock_is_followed():
    """100 ppm for ten minutes are 60 ms."""
    stream, ages = TelemetryStream(WIRE.safety), []
    for n in range(60_000):
        measurement = stream.accept(frame(round(10.0 * n * (1 - 1e-4))), 0.01 * n)
        if measurement is not None:
            ages.append(measurement.arrival - measurement.sampled)
    assert max(ages) < 0.004 and stream.impossible == 0


def test_duplicates_and_overtaken_frames_are_dropped():
    stream = running()
    assert stream.accept(frame(990.0), 6.0) is None and stream.accept(frame(980.0), 6.01) is None
    assert stream.repeated == 2


@pytest.mark.parametrize(
    "values",
    [
        {"pos": np.eye(12)[3]},
        {"pos": np.full(12, 7.0)},
        {"vel": np.full(12, 1e6)},
        {"roll": 1.0},
        {"pitch_rate": 1e3},
        {"yaw": 1e9},
        {"ts": 1200.0},
        {"ts": 4e9},
    ],
    ids=str,
)
def test_an_impossible_frame_is_not_accepted(values: dict):
    stream = running()
    assert stream.accept(replace(frame(1000.0), **values), 6.003) is None and stream.impossible == 1
    after = stream.accept(frame(1010.0), 6.013)
    assert after is not None and after.arrival - after.sampled == pytest.approx(0.0), "the clock offset is unchanged"
    assert stream.impossible_in_a_row == 0


def test_several_impossible_frames_in_a_row_are_a_fault():
    stream = running()
    for n in range(WIRE.safety.implausible_frames):
        check_stream(stream, WIRE.safety, 6.0)
        stream.accept(frame(1000.0 + 10 * n, pos=np.full(12, 0.9)), 6.003 + 0.01 * n)
    with pytest.raises(RobotFault, match="implausible"):
        check_stream(stream, WIRE.safety, 6.04)


def test_a_restart_of_the_robot_is_a_fault():
    stream = running(1000)
    for n in range(3):
        stream.accept(frame(10.0 * n), 16.0 + 0.01 * n)
    with pytest.raises(RobotFault, match="implausible"):
        check_stream(stream, WIRE.safety, 16.04)


def test_old_telemetry_is_a_fault_whether_it_stops_or_is_late():
    stream = running()
    check_stream(stream, WIRE.safety, 6.05)
    with pytest.raises(RobotFault, match="stale"):
        check_stream(stream, WIRE.safety, 6.2)
    for n in range(1, 4):  # frames keep coming, each 150 ms late
        stream.accept(frame(990.0 + 10.0 * n), 6.14 + 0.01 * n)
    with pytest.raises(RobotFault, match="stale"):
        check_stream(stream, WIRE.safety, 6.171)
    with pytest.raises(RobotFault, match="none yet"):
        check_stream(TelemetryStream(WIRE.safety), WIRE.safety, 0.0)
