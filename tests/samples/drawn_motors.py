"""Motors of the Pupper, drawn for every episode."""

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd


def draw_pd(rng: np.random.Generator) -> IdealPd:
    """A PD with random gains, armature [kg·m²] and delay [s]."""
    kp = rng.uniform(8.0, 10.0, 12)
    armature = rng.uniform(0.002, 0.004, 12)
    delay = rng.uniform(0.0, 0.01, 12)
    return IdealPd.without_friction(kp, 0.095 * kp, np.full(12, 1.26), armature, delay)
