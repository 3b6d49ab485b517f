"""Figures of the control loop's timing."""

import pytest

from motorprior.hardware.control_loop import Timing, clock_figures


def test_figures_of_a_clock_equal_arithmetic():
    timing = Timing()
    timing.sent.extend([0.010, 0.020, 0.031, 0.041, 0.061])
    timing.late.extend([0.0, 0.001, 0.006, 0.0, 0.0])
    timing.age.extend([0.002] * 4 + [0.012])
    timing.skipped = 1
    figures = clock_figures([timing], 0.01)
    assert figures["period_jitter_ms/max"] == pytest.approx(10.0)
    assert figures["period_jitter_ms/p50"] == pytest.approx(0.5)
    assert figures["missed_share"] == pytest.approx(2 / 6)  # one 6 ms late, one left out, of six
    assert (figures["telemetry_age_ms/p50"], figures["telemetry_age_ms/max"]) == pytest.approx((2.0, 12.0))
    assert not clock_figures([Timing()], 0.01)
