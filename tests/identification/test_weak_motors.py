"""Adaptation to weak motors advises that their torque limits may be lower, too."""

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_posterior import kp_ratio
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.priors.adapt import advice_on_weak_motors, weak_below

NAMES = ("hip", "knee", "ankle")


@pytest.fixture
def box(grey_box) -> GreyBox:
    return grey_box(spread=0.1, kp=9.0)


@pytest.fixture
def prior(box: GreyBox) -> MotorPrior:
    return MotorPrior(box, np.zeros((3, 3)), np.zeros((3, 3)), "rollout", "pupper_v2", "m", {})


def latents(box: GreyBox, *shares: float) -> np.ndarray:
    """(M, Z) latents of motors with these shares of the central motor's kp."""
    steepest = box.slope[:, PARAMETERS.index("kp")]
    z = np.log(shares)[:, None] * steepest / (steepest @ steepest)
    np.testing.assert_allclose(kp_ratio(box, z), shares, rtol=1e-9)
    return z


def test_no_advice_for_motors_like_the_prior(prior: MotorPrior, box: GreyBox):
    barely_strong = weak_below(box)[0] + 0.02

    assert advice_on_weak_motors(prior, NAMES, latents(box, 1.1, barely_strong, 1.0)) == ""


def test_advice_for_a_weak_robot_names_every_motor_below_the_central_one(
    prior: MotorPrior, box: GreyBox
):
    advice = advice_on_weak_motors(prior, NAMES, latents(box, 1.1, 0.80, 0.75))
    assert "knee 0.80" in advice
    assert "ankle 0.75" in advice
    assert "hip" not in advice
