"""The trot walks towards +x, is periodic and symmetric, and stands still at intensity 0."""

import math

import numpy as np
import pytest

from motorprior.locomotion.body import body_of
from motorprior.locomotion.trajectory_generator import advance_phase, joint_targets, warp_phase
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import (
    JOINT_LOWER,
    JOINT_UPPER,
    NOMINAL_POSE,
    SHANK_LENGTH,
    THIGH_LENGTH,
)

FR, FL, RR, RL = range(4)
BODY = body_of(PUPPER_V2)


def targets(phase, intensity=0.5, height=0.25, ratio=1.0):
    out = np.full(12, np.nan)
    joint_targets(BODY, phase, intensity, height, ratio, out)
    return out.reshape(4, 3)


def foot(leg_targets):
    """Foot relative to the hip (x forward, z up), two links that turn about +y."""
    _, hip, knee = leg_targets
    x = -(THIGH_LENGTH * math.sin(hip) + SHANK_LENGTH * math.sin(hip + knee))
    z = -(THIGH_LENGTH * math.cos(hip) + SHANK_LENGTH * math.cos(hip + knee))
    return x, z


@pytest.mark.parametrize("ratio", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("intensity", [0.3, 1.0])
def test_foot_goes_back_in_stance_and_forward_and_up_in_swing(intensity, ratio):
    stance_share = 1.0 / (1.0 + ratio)
    stance = np.array([foot(targets(p, intensity, 0.0, ratio)[FR]) for p in np.linspace(0, stance_share, 40)[:-1]])
    swing = np.array([foot(targets(p, intensity, 0.0, ratio)[FR]) for p in np.linspace(stance_share, 1, 40)[:-1]])
    assert np.all(np.diff(stance[:, 0]) < 0.0)  # backwards relative to the body, so the body goes forward
    assert swing[-1, 0] - swing[0, 0] > 0.8 * (stance[0, 0] - stance[-1, 0])
    lift = swing[1:-1, 1].max() - stance[:, 1].max()
    assert lift > 0.02 * intensity
    assert swing[19, 1] > swing[0, 1] and swing[19, 1] > swing[-1, 1]


def test_stride_at_full_intensity_by_hand():
    # φ = 0: swing = 0.5, extend = 0, so hip 0.1 and knee -1.2. φ = π: hip 1.1.
    # φ = 3π/2: extend = -0.9, so hip 0.6 + 0.45. φ = π/2: extend = -0.02.
    assert targets(0.0, 1.0, 0.0)[FR] == pytest.approx([0.0, 0.1, -1.2])
    assert targets(0.5, 1.0, 0.0)[FR] == pytest.approx([0.0, 1.1, -1.2])
    assert targets(0.75, 1.0, 0.0)[FR] == pytest.approx([0.0, 1.05, -2.1])
    assert targets(0.25, 1.0, 0.0)[FR] == pytest.approx([0.0, 0.61, -1.22])


def test_zero_intensity_is_a_constant_pose():
    for phase in np.linspace(0.0, 0.999, 17):
        np.testing.assert_allclose(targets(phase, 0.0, 0.0, 0.7).ravel(), NOMINAL_POSE, atol=1e-15)
        np.testing.assert_array_equal(targets(phase, 0.0, 0.4), targets(0.0, 0.0, 0.4))


def test_height_stretches_the_legs():
    tall, nominal, low = (foot(targets(0.1, 0.0, h)[RL])[1] for h in (0.5, 0.0, -0.5))
    assert tall < nominal < low < 0.0


@pytest.mark.parametrize("ratio", [0.2, 1.0, 3.0])
def test_diagonal_legs_agree_and_half_a_cycle_swaps_the_pairs(ratio):
    for phase in (0.0, 0.125, 0.375, 0.5, 0.8125):
        now, later = targets(phase, 0.8, 0.1, ratio), targets((phase + 0.5) % 1.0, 0.8, 0.1, ratio)
        np.testing.assert_array_equal(now[FR], now[RL])
        np.testing.assert_array_equal(now[FL], now[RR])
        np.testing.assert_array_equal(now[FR], later[FL])
        np.testing.assert_array_equal(now[FL], later[FR])


@pytest.mark.parametrize("ratio", [0.2, 1.0, 5.0])
def test_targets_are_continuous_over_the_whole_cycle(ratio):
    path = np.array([targets(p, 1.0, 0.0, ratio) for p in (np.arange(4000) % 4000) / 4000])
    steps = np.abs(np.diff(np.concatenate([path, path[:1]]), axis=0))
    assert steps.max() < 0.02


def test_stance_takes_one_part_in_one_plus_ratio():
    for ratio in (0.2, 1.0, 4.0):
        grid = (np.arange(2000) + 0.5) / 2000
        share = np.mean([warp_phase(p, ratio) < math.pi for p in grid])
        assert share == pytest.approx(1.0 / (1.0 + ratio), abs=1e-3)
    assert warp_phase(0.0, 2.0) == 0.0
    assert warp_phase(1.0 - 1e-12, 2.0) == pytest.approx(2.0 * math.pi)


def test_phase_advances_and_wraps():
    assert advance_phase(0.2, 1.25, 0.01) == pytest.approx(0.2125)
    assert advance_phase(0.99, 2.0, 0.01) == pytest.approx(0.01)
    phase = 0.0
    for _ in range(1000):  # 10 s at 1.3 Hz: 13 cycles
        phase = advance_phase(phase, 1.3, 0.01)
        assert 0.0 <= phase < 1.0
    assert min(phase, 1.0 - phase) == pytest.approx(0.0, abs=1e-9)


def test_full_range_stays_inside_the_joint_limits():
    for phase in np.linspace(0, 0.99, 50):
        for height in (-0.5, 1.0):
            out = targets(phase, 1.0, height, 0.2).ravel()
            assert np.all(out >= JOINT_LOWER) and np.all(out <= JOINT_UPPER)
