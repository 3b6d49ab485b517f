"""Adapting to weak motors reports that their torque limits may be lower, too."""

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
    """(M, Z) of motors with these shares of the central motor's kp."""
    steepest = box.slope[:, PARAMETERS.index("kp")]
    z = np.log(shares)[:, None] * steepest / (steepest @ steepest)
    np.testing.assert_allclose(kp_ratio(box, z), shares, rtol=1e-9)
    return z


def test_no_advice_for_motors_like_the_prior(prior: MotorPrior, box: GreyBox):
    assert (
        advice_on_weak_motors(prior, NAMES, latents(box, 1.1, weak_below(box)[0] + 0.02, 1.0)) == ""
    )


def test_of_a_weak_robot_every_motor_below_the_central_one_is_named(
    prior: MotorPrior, box: GreyBox
):
    advice = advice_on_weak_motors(prior, NAMES, latents(box, 1.1, 0.80, 0.75))
    assert "knee 0.80" in advice and "ankle 0.75" in advice and "hip" not in advice
