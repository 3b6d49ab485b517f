"""Excitations and ramps stay within their limits, a gyroscope's bias is removed, and timing is arithmetic."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from policies import as_file_content, random_policy
from telemetry import telemetry

from motorprior.bench.excitation import EXCITATIONS
from motorprior.hardware.control_loop import Timing, clock_figures, ramp
from motorprior.hardware.deploy import PolicyMotion
from motorprior.hardware.excitations import OF_ROBOTS, excitation_targets, joints_of
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@given(
    kind=st.sampled_from([*EXCITATIONS, *OF_ROBOTS]),
    joint=st.sampled_from(["all", "FR", "knee", "RL_hip"]),
    seconds=st.floats(1.0, 20.0),
    amplitude=st.floats(0.05, 1.5),
    speed=st.floats(0.5, 20.0),
    seed=st.integers(0, 100),
)
@settings(max_examples=40, deadline=None)
def test_an_excitation_stays_within_amplitude_and_speed(kind, joint, seconds, amplitude, speed, seed):
    targets = excitation_targets(PUPPER_V2, kind, joints_of(PUPPER_V2, joint), seconds, amplitude, speed, seed)
    away = targets - spec.NOMINAL_POSE
    assert np.abs(away).max() <= amplitude + 1e-9
    assert np.all(targets >= spec.JOINT_LOWER) and np.all(targets <= spec.JOINT_UPPER)
    moving = set(np.flatnonzero(np.abs(away).max(axis=0)))
    assert moving <= set(joints_of(PUPPER_V2, joint)) and moving
    assert np.abs(away[0]).max() == 0.0 and np.abs(away[-1]).max() < 1e-9
    smooth = targets[: len(targets) // 2] if kind == "varied" else targets
    if kind != "steps":
        assert np.abs(np.diff(smooth, axis=0)).max() <= speed * spec.CONTROL_DT + 1e-9


def test_a_ramp_begins_and_ends_softly_and_keeps_its_speed():
    start, goal = np.zeros(12), np.linspace(-1.0, 2.0, 12)
    motion, row = ramp(start, goal, 1.5, 0.01, hold=0.1), []
    while (target := motion(Measurement(telemetry(), 0.0, 0.0))) is not None:
        row.append(target)
    speeds = np.abs(np.diff([start, *row], axis=0)) / 0.01
    assert speeds.max() <= 1.5 and speeds[0].max() < 0.05 and np.array_equal(row[-1], goal)
    assert len([target for target in row if np.array_equal(target, goal)]) >= 10


def test_a_gyroscope_s_bias_does_not_change_the_heading():
    """Two robots stand still, one with a bias."""
    still = telemetry(pos=spec.NOMINAL_POSE)
    turning = telemetry(pos=spec.NOMINAL_POSE, yaw_rate=0.03, roll_rate=-0.02)
    motions = [PolicyMotion(PUPPER_V2, as_file_content(random_policy(0.05, seed=1))) for _ in range(3)]
    motions[1].gyro_bias = np.array([-0.02, 0.0, 0.03])
    for motion, seen in zip(motions, (still, turning, turning), strict=True):
        motion.forward = 0.2
        for _ in range(50):
            motion(Measurement(seen, 0.0, 0.0))
    right, corrected, wrong = (motion.gait.observation for motion in motions)
    np.testing.assert_allclose(corrected, right, atol=1e-12)
    assert not np.allclose(wrong, right, atol=1e-3)


def test_figures_of_a_clock_equal_arithmetic():
    timing = Timing([0.010, 0.020, 0.031, 0.041, 0.061], [0.0, 0.001, 0.006, 0.0, 0.0], [0.002] * 4 + [0.012], 1)
    figures = clock_figures([timing], 0.01)
    assert figures["period_jitter_ms/max"] == pytest.approx(10.0)
    assert figures["period_jitter_ms/p50"] == pytest.approx(0.5)
    assert figures["missed_share"] == pytest.approx(2 / 6)  # one 6 ms late, one left out, of six
    assert (figures["telemetry_age_ms/p50"], figures["telemetry_age_ms/max"]) == pytest.approx((2.0, 12.0))
