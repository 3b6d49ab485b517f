"""Motors of the Pupper, drawn for every episode."""

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd


def draw_pd(rng: np.random.Generator) -> IdealPd:
    """A PD with armature and delay."""
    kp = rng.uniform(8.0, 10.0, 12)
    return IdealPd(
        kp, 0.095 * kp, np.full(12, 1.26), rng.uniform(0.002, 0.004, 12), rng.uniform(0.0, 0.01, 12)
    )
