"""Motors that are much weaker than those that a prior knows, and what to do about them."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_posterior import kp_share
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import listed

_NAMED = 10
"""Most weak motors that are named."""
WEAK_MOTOR, WEAK_ROBOT = 0.7, 0.85
"""Share of the central motor's kp below which one motor, or the median of a robot's, is called weak at most [-]."""
_FAR_MOTOR, _FAR_ROBOT = 2.93, 1.33
"""The same in standard deviations of the logarithm of kp over the prior's draws, where the fleet differs by more: one
sound robot of twelve motors in fifty has a motor so far below. As many have such a median if a third of the variance
is common to the motors of a robot."""
_DRAWS = 1000


def advice_on_weak_motors(prior: MotorPrior, names: tuple[str, ...], latents: np.ndarray) -> str:
    """What to do where motors (M, Z) have far smaller gains than the prior's central one; "" where none has."""
    if prior.network.motor is None:
        return ""
    share, (motor_bound, robot_bound) = kp_share(prior.network, latents), weak_below(prior.network)
    weak = np.flatnonzero(share < (1.0 if np.median(share) < robot_bound else motor_bound))
    if not weak.size:
        return ""
    named = listed([f"{names[motor]} {share[motor]:.2f}" for motor in weak], _NAMED)
    return (
        f"weak motors, as shares of the central motor's kp: {named}. If they give less torque per ampere, their "
        "torque limits are lower, too, which a log in the air hardly shows -> train on this posterior "
        "with limit_follows_gain"
    )


def weak_below(network: LatentNetwork) -> tuple[float, float]:
    """Shares of the central motor's kp below which a motor, and the median of a robot's, is called weak [-]."""
    draws = np.random.default_rng(0).standard_normal((_DRAWS, network.num_latents))
    spread = float(np.std(np.log(kp_share(network, draws))))
    return min(WEAK_MOTOR, float(np.exp(-_FAR_MOTOR * spread))), min(WEAK_ROBOT, float(np.exp(-_FAR_ROBOT * spread)))
