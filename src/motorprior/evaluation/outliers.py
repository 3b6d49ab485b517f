"""Tests whether new motors are outliers of the fleet that a prior was trained on.

`outliers` tests whether new motors lie inside the prediction interval of the M training motors. The
loss of a fit alone has little power. Every motor is therefore fitted again, with a prior
PRIOR_SCALE times as wide as the training motors, which barely shrinks the estimate. With the
training motors' mean m and standard deviation s in decoder latents,

    t = (found - m) / (s·√(1 + 1/M + v)),   p = min(1, L·min over latents of P(|Student's t with M - 1| > |t|))

v·s² is the posterior variance of the second fit. p has a Bonferroni correction over the L latents
in which the training motors differ. With C classes of joints, m and M in t are those of the motor's
class, s is pooled over the classes, and t has M - C degrees of freedom, with all M training motors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.evaluation.reference import LOSS_METRICS
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData

PRIOR_SCALE = 3.0  # standard deviation of the second fit's prior over that of the training motors
_SAME = 1e-9  # up to this standard deviation of a latent, training motors differ only by rounding


@dataclass(frozen=True)
class Outliers:
    """Result of the test for M motors."""

    p_value: np.ndarray  # (M,) p, the probability that one more motor of the fleet lies as far out
    latent: tuple[str, ...]  # M names, of the latent with the smallest p-value of each motor
    deviation: np.ndarray  # (M,) t of that latent
    distance: np.ndarray  # (M,) its distance from the mean of the class


def outliers(
    model: Decoder,
    trained: np.ndarray,
    found: np.ndarray,
    data: TrainingData,
    preset: Recipe,
    temperature: float,
    classes: ClassLatents,
    of: Sequence[str],
) -> Outliers:
    """Test each of N motors, of the classes ``of``, against the training motors of a prior's model and its ``classes``.

    ``trained`` (M, Z) are posterior means of the training motors, ``found`` (N, Z) those of the new
    motors, from `fit_posterior`; ``data``, ``preset`` and ``temperature`` are as for
    `fit_posterior`.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    latents = model.decoder_latents(trained)
    groups = [classes.rows_of(name) for name in of]
    known = [classes.rows_of(name) for name in classes.names]
    raw = np.stack([latents[rows].mean(axis=0) for rows in known])
    freedom = len(latents) - len(known)
    residual = latents - raw[[classes.names.index(name) for name in classes.of_motors]]
    std = np.maximum(np.sqrt(np.sum(residual**2, axis=0) / freedom), _SAME)
    mean = latents.mean(axis=0)
    count = np.array([[len(rows)] for rows in groups])
    middle = np.stack([latents[rows].mean(axis=0) for rows in groups])  # (N, Z)
    differ = std > _SAME
    scale = PRIOR_SCALE * std
    wide = Copula(np.eye(len(mean)), mean + scale * SCORES[:, None])
    center = (middle - mean) / scale
    start = np.where(differ, (model.decoder_latents(found) - mean) / scale, center)
    # farther starts may be out of reach of the steps
    start = np.clip(start, center - 1.0, center + 1.0)
    prior = (center, np.ones(center.shape))
    refit = fit_posterior(
        replace(model, copula=wide), data, preset, temperature, start=start, prior=prior
    )
    variance = PRIOR_SCALE**2 * np.diagonal(refit.covariance, axis1=1, axis2=2)
    away = PRIOR_SCALE * (refit.mean - center)
    t = away / np.sqrt(1.0 + 1.0 / count + variance)
    p_values = np.where(differ, 2.0 * student_t.sf(np.abs(t), freedom), 1.0)
    worst = p_values.argmin(axis=1)
    rows = np.arange(len(t))
    p_value = np.minimum(1.0, max(1, int(differ.sum())) * p_values[rows, worst])
    names = [f"latent {index}" for index in range(model.num_latents)]
    # one latent per constant
    if isinstance(model, GreyBox) and len(model.center) == model.num_latents:
        names = parameters_of(model.terms)
    return Outliers(
        p_value, tuple(names[index] for index in worst), t[rows, worst], (away * std)[rows, worst]
    )


def loss_p_value(
    metrics: Mapping[str, float], losses: np.ndarray, count: float, suffix: str = ""
) -> np.ndarray:
    """(M,) one-sided p-value of the fits: probability that a motor of the prior's fleet has a loss as large [-].

    Mean losses are modelled as log-normal over motors, and the mean over n blocks of one motor's
    log as log-normal too, with the moments of a sum (Fenton & Wilkinson):

        log loss ~ N(m - v/2, s² + v),   v = max(0, log(1 + V/n) - log(1 + V/N))

    where m and s come from logs of N blocks, and V is the variance of a block. Since s is estimated
    from the training motors, the test uses Student's t with motors - 1 degrees of freedom and s²·(1
    + 1/motors). ``metrics`` are those of the prior with this ``suffix``, ``losses`` (M,) mean
    window losses of the new motors at their posterior means, and ``count`` is n, the number of
    blocks of their log, which may be a fraction.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    _, m, s, motors, whole, variance = (metrics[f"loss_{name}{suffix}"] for name in LOSS_METRICS)
    added = max(0.0, math.log1p(variance / count) - math.log1p(variance / whole))
    std = math.sqrt(max(s**2 * (1 + 1 / motors) + added, 1e-12))
    return student_t.sf((np.log(losses) - m + added / 2) / std, max(motors - 1, 1))
