"""Which frames are accepted, and how old they are."""

import numpy as np
import pytest
from telemetry import telemetry

from motorprior.hardware.telemetry_stream import TelemetryStream
from motorprior.robots.pupper_v2.robot import PUPPER_V2

LIMITS = PUPPER_V2.require_wire().safety


def running() -> TelemetryStream:
    """100 frames at 100 Hz, 3 ms of transmission."""
    stream = TelemetryStream(LIMITS)
    for n in range(100):
        assert stream.accept(telemetry(ts=10.0 * n), 5.0 + 0.01 * n + 0.003) is not None
    return stream


def test_age_is_the_delay_beyond_the_shortest_transmission():
    late = running().accept(telemetry(ts=1000.0), 6.0 + 0.003 + 0.04)
    assert late is not None and late.arrival - late.sampled == pytest.approx(0.04)


def test_a_damaged_time_stamp_does_not_make_later_frames_look_old():
    """25 ms ahead, which a real frame could be; the next two look overtaken."""
    stream = running()
    assert stream.accept(telemetry(ts=1025.0), 6.003) is not None
    dropped = [stream.accept(telemetry(ts=1000.0 + 10.0 * n), 6.003 + 0.01 * n) is None for n in (1, 2, 3)]
    assert dropped == [True, True, False] and stream.repeated == 2
    later = stream.accept(telemetry(ts=1040.0), 6.043)
    assert later is not None and later.arrival - later.sampled == pytest.approx(0.0)


def test_a_drifting_clock_is_followed():
    """300 ppm for 100 s are 30 ms."""
    stream, ages = TelemetryStream(LIMITS), []
    for n in range(10_000):
        measurement = stream.accept(telemetry(ts=round(10.0 * n * (1 - 3e-4))), 0.01 * n)
        if measurement is not None:
            ages.append(measurement.arrival - measurement.sampled)
    assert max(ages) < 0.006 and stream.impossible == 0


IMPOSSIBLE = [
    *({"pos": np.eye(12)[3]}, {"pos": np.full(12, 7.0)}, {"vel": np.full(12, 1e6)}, {"roll": 1.0}),
    *({"pitch_rate": 1e3}, {"yaw": 1e9}, {"ts": 1200.0}, {"ts": 4e9}),
]


@pytest.mark.parametrize("values", IMPOSSIBLE, ids=str)
def test_an_impossible_frame_is_not_accepted(values: dict):
    stream = running()
    assert stream.accept(telemetry(**{"ts": 1000.0, **values}), 6.003) is None and stream.impossible == 1
    after = stream.accept(telemetry(ts=1010.0), 6.013)
    assert after is not None and after.arrival - after.sampled == pytest.approx(0.0), "the clock offset is unchanged"
    assert stream.impossible_in_a_row == 0
