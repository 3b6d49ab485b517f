"""A leg's angles put its foot where they were asked to."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.locomotion.body import leg_angles


def foot(thigh: float, shank: float, hip: float, knee: float) -> tuple[float, float]:
    """Forward of and below the hip axis: two links that turn about +y, hanging down at zero."""
    forward = -(thigh * math.sin(hip) + shank * math.sin(hip + knee))
    return forward, thigh * math.cos(hip) + shank * math.cos(hip + knee)


@given(
    thigh=st.floats(0.05, 0.5),
    ratio=st.floats(0.5, 2.0),
    hip=st.floats(-3.1, 3.1),
    knee=st.floats(0.06, 3.08),
    side=st.sampled_from([-1.0, 1.0]),
)
@settings(deadline=None)  # the first call compiles
def test_inverse_of_forward_kinematics_for_both_sides_of_the_knee(thigh, ratio, hip, knee, side):
    shank = ratio * thigh
    found = leg_angles(thigh, shank, *foot(thigh, shank, hip, side * knee), side)
    assert found[1] == pytest.approx(side * knee, abs=1e-9)
    assert math.remainder(found[0] - hip, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("forward", "below"), [(0.0, 1.0), (0.3, 0.4), (-2.0, 0.1)])
def test_a_place_too_far_away_is_reached_for_with_a_nearly_straight_leg(forward, below, side):
    hip, knee = leg_angles(0.1, 0.12, forward, below, side)
    assert knee == pytest.approx(side * math.acos(0.999))
    there, distance = foot(0.1, 0.12, hip, knee), math.hypot(forward, below)
    assert math.hypot(*there) == pytest.approx(0.22, rel=1e-3)
    assert there[0] * forward + there[1] * below == pytest.approx(math.hypot(*there) * distance), "in its direction"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_place_too_near_folds_the_leg_and_the_hip_itself_is_no_division_by_zero(side):
    for forward, below in ((0.0, 0.005), (0.0, 0.0), (-0.01, 0.0)):
        hip, knee = leg_angles(0.1, 0.12, forward, below, side)
        assert math.isfinite(hip) and knee == pytest.approx(side * math.acos(-0.999))
    assert foot(0.1, 0.12, *leg_angles(0.1, 0.12, 0.0, 0.005, side))[0] == pytest.approx(0.0, abs=1e-12)
