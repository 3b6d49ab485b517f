"""Whether one of the motors of a prior stands out among its others.

Of every motor each decoder latent z_i (for preset rollout the logarithm of a constant) is compared with those of the
M - 1 others, of mean m and standard deviation s,

    t = (z_i - m) / √(s²·(1 + 1/(M - 1)) + v),   p = min(1, Z·min over latents of P(|Student's t with M - 2| > |t|))

with v the posterior variance of z_i: the prediction interval of one more motor, as in `outliers`, but without another
fit.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student_t

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.latents.outliers import Outliers, latent_names

FEWEST = 4  # Motors among which one can stand out
_SMALLEST = 1e-9


def stand_out(prior: MotorPrior) -> Outliers | None:
    """The test of every motor that the prior was trained on; None if there are fewer than FEWEST, or no latents."""
    network, motors = prior.network, len(prior.mean)
    if motors < FEWEST or network.num_latents == 0:
        return None
    latents = network.decoder_latents(prior.mean)
    share = np.exp(prior.log_var) / np.maximum(prior.mean.var(axis=0), _SMALLEST)  # of the motors' own variance
    unsure = np.minimum(share, 1.0) * latents.var(axis=0)
    t = np.empty_like(latents)
    for motor in range(motors):
        others = np.delete(latents, motor, axis=0)
        spread = others.var(axis=0, ddof=1) * (1.0 + 1.0 / (motors - 1)) + unsure[motor]
        t[motor] = (latents[motor] - others.mean(axis=0)) / np.sqrt(np.maximum(spread, _SMALLEST**2))
    p_values = 2.0 * student_t.sf(np.abs(t), motors - 2)
    worst, rows, names = p_values.argmin(axis=1), np.arange(motors), latent_names(network)
    p_value = np.minimum(1.0, network.num_latents * p_values[rows, worst])
    return Outliers(p_value, tuple(names[index] for index in worst), t[rows, worst])
