"""How far the motors of one model differ, where too few of them were recorded to tell.

An assumption that every recorded motor makes weaker: a scaled inverse-χ² prior on the variance of each of a decoder's
outputs, worth WORTH motors around s², and nothing known of its mean. Of M motors with outputs z_i and mean z̄ one more
has a t distribution around z̄, WORTH + M - 1 degrees of freedom wide by √v,

    v = (WORTH·s² + Σ_i (z_i - z̄)²) / (WORTH + M - 1) · (M + 1)/M

of which a normal distribution with that standard deviation is kept (Gelman et al., Bayesian Data Analysis, 3rd ed.,
sections 3.2 and 3.3).
"""

from __future__ import annotations

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.logs.motor_log import FIRMWARE

WORTH = 3.0  # Motors that the assumption is worth
# s of each constant: of its logarithm, but for encoder_zero, whose unit is 0.05 rad. Gains and armature have the
# spread between motors of one robot that was found in logs of a real quadruped, the one that the library comes
# with; the others are ours. Registers of a firmware are the same in all motors.
SPREADS = {
    "kp": 0.1, "kd_over_kp": 0.03, "torque_limit": 0.1, "armature": 0.1, "stall_torque": 0.1, "no_load_speed": 0.05,
    "backlash": 0.4, "encoder_zero": 0.2, "integral_rate": 0.05, "integral_limit": 0.05,
} | dict.fromkeys(FIRMWARE, 0.0)  # fmt: skip
OTHER = 0.25  # s of every other constant: the spread of Coulomb friction there


def assumed_spread(terms: tuple[str, ...], held: np.ndarray) -> np.ndarray:
    """(P,) s of the outputs of a decoder with these terms; 0 where ``held`` (P,) says that a constant is not fitted."""
    spread = np.array([SPREADS.get(name, OTHER) for name in parameters_of(terms)])
    return np.where(held, 0.0, spread)


def spread_of_few(z: np.ndarray, assumed: np.ndarray) -> np.ndarray:
    """(P,) √v of M motors' outputs z (M, P), with ``assumed`` s (P,)."""
    motors = len(z)
    scatter = np.sum((z - z.mean(axis=0)) ** 2, axis=0)
    return np.sqrt((WORTH * assumed**2 + scatter) / (WORTH + motors - 1) * (motors + 1) / motors)
