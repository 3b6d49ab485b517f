"""Advice for motors that are much weaker than the samples of a prior."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_posterior import kp_ratio
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import listed

# a motor, or the median of a robot's motors, is weak below this share of the central motor's kp [-] ...
WEAK_MOTOR, WEAK_ROBOT = 0.7, 0.85
# ... and below so many standard deviations of log(kp) over samples of the prior. One in fifty healthy robots of twelve
# motors has a motor below, and one in fifty such a median if the motors of a robot share a third of the variance.
_FAR_MOTOR, _FAR_ROBOT = 2.93, 1.33


def advice_on_weak_motors(prior: MotorPrior, names: tuple[str, ...], latents: np.ndarray) -> str:
    """Advice if some of the motors (M, Z) have a much smaller kp than the prior's central motor, else ""."""
    if prior.network.motor is None:
        return ""
    share, (motor_bound, robot_bound) = kp_ratio(prior.network, latents), weak_below(prior.network)
    weak = np.flatnonzero(share < (1.0 if np.median(share) < robot_bound else motor_bound))
    if not weak.size:
        return ""
    named = listed([f"{names[motor]} {share[motor]:.2f}" for motor in weak], 10)
    return (
        f"weak motors, as shares of the central motor's kp: {named}. If they give less torque per ampere, their torque "
        "limits are also lower, which in-air logs barely identify -> train on this posterior with limit_follows_gain"
    )


def weak_below(network: LatentNetwork) -> tuple[float, float]:
    """Shares of the central motor's kp below which a motor, and the median of a robot's motors, is weak [-]."""
    samples = np.random.default_rng(0).standard_normal((1000, network.num_latents))
    deviation = float(np.std(np.log(kp_ratio(network, samples))))
    bounds = np.exp(-_FAR_MOTOR * deviation), np.exp(-_FAR_ROBOT * deviation)
    return min(WEAK_MOTOR, float(bounds[0])), min(WEAK_ROBOT, float(bounds[1]))
