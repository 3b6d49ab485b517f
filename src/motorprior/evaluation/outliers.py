"""Tests whether new motors are outliers of the fleet that a prior was trained on.

`outliers` tests whether new motors lie inside the prediction interval of the M training motors. The
loss of a fit alone has little power. Every motor is therefore fitted again, with a prior
PRIOR_SCALE times as wide as the training motors, which barely shrinks the estimate. With the
training motors' mean m and standard deviation s in decoder latents,

    t = (latent - m) / (s·√(1 + 1/M + v)),
    p = min(1, L·min over latents of P(|Student's t with M - 1| > |t|))

v·s² is the posterior variance of the second fit. p has a Bonferroni correction over the L latents
in which the training motors differ. With C classes of joints, m and M in t are those of the motor's
class, s is pooled over the classes, and t has M - C degrees of freedom, with all M training motors.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.fit_metrics import LossStatistics
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder, MotorPrior
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
    prior: MotorPrior,
    latents: np.ndarray,
    data: TrainingData,
    recipe: Recipe,
    temperature: float,
    joint_classes: Sequence[str],
) -> Outliers:
    """Test each of N new motors against the training motors of a prior.

    Args:
        prior: with M training motors.
        latents: (N, Z) posterior means of the new motors, from `fit_posterior`.
        data: of the new motors, as for `fit_posterior`.
        recipe: as for `fit_posterior`.
        temperature: as for `fit_posterior`.
        joint_classes: of the new motors.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    model = prior.model
    classes = prior.classes
    trained = model.decoder_latents(prior.mean)

    # standard deviation within the classes, pooled
    rows_of_classes = [classes.rows_of(name) for name in classes.names]
    class_means = np.stack([trained[rows].mean(axis=0) for rows in rows_of_classes])
    class_index = [classes.names.index(name) for name in classes.of_motors]
    residual = trained - class_means[class_index]
    freedom = len(trained) - len(rows_of_classes)
    std = np.maximum(np.sqrt(np.sum(residual**2, axis=0) / freedom), _SAME)
    differ = std > _SAME

    # number and mean of the training motors of each new motor's class
    rows_of_new = [classes.rows_of(name) for name in joint_classes]
    count = np.array([[len(rows)] for rows in rows_of_new])
    expected = np.stack([trained[rows].mean(axis=0) for rows in rows_of_new])  # (N, Z)

    # fit again, with a wide prior: latents are (decoder latent - mean) / scale
    mean = trained.mean(axis=0)
    scale = PRIOR_SCALE * std
    wide = Copula(np.eye(len(mean)), mean + scale * SCORES[:, None])
    center = (expected - mean) / scale
    start = np.where(differ, (model.decoder_latents(latents) - mean) / scale, center)
    # farther starts may be out of reach of the steps
    start = np.clip(start, center - 1.0, center + 1.0)
    wide_prior = (center, np.ones(center.shape))
    refit = fit_posterior(
        replace(model, copula=wide), data, recipe, temperature, start=start, prior=wide_prior
    )

    variance = PRIOR_SCALE**2 * np.diagonal(refit.covariance, axis1=1, axis2=2)
    away = PRIOR_SCALE * (refit.mean - center)
    t = away / np.sqrt(1.0 + 1.0 / count + variance)
    p_values = np.where(differ, 2.0 * student_t.sf(np.abs(t), freedom), 1.0)

    motors = np.arange(len(t))
    worst = p_values.argmin(axis=1)
    num_tests = max(1, int(differ.sum()))
    names = _latent_names(model)
    return Outliers(
        p_value=np.minimum(1.0, num_tests * p_values[motors, worst]),
        latent=tuple(names[int(index)] for index in worst),
        deviation=t[motors, worst],
        distance=(away * std)[motors, worst],
    )


def _latent_names(model: Decoder) -> tuple[str, ...]:
    """Names of the latents: the constants' if there is one latent per constant."""
    if isinstance(model, GreyBox) and len(model.center) == model.num_latents:
        return parameters_of(model.terms)
    return tuple(f"latent {index}" for index in range(model.num_latents))


def loss_p_value(training_losses: LossStatistics, losses: np.ndarray, blocks: float) -> np.ndarray:
    """(M,) one-sided p-value of the fits.

    It is the probability that a motor of the prior's fleet has a loss as large [-].

    Mean losses are modelled as log-normal over motors, and the mean over n blocks of one motor's
    log as log-normal too, with the moments of a sum (Fenton & Wilkinson):

        log loss ~ N(m - v/2, s² + v),   v = max(0, log(1 + V/n) - log(1 + V/N))

    where m and s come from logs of N blocks, and V is the variance of a block. Since s is estimated
    from the training motors, the test uses Student's t with motors - 1 degrees of freedom and s²·(1
    + 1/motors). One training motor does not tell s, and p is then 1.

    Args:
        training_losses: losses of the training motors.
        losses: (M,) mean window losses of the new motors at their posterior means.
        blocks: n, the number of blocks in the log of the new motors, which may be a fraction.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    if training_losses.motors == 1:
        return np.ones(len(losses))
    variance = training_losses.block_variance
    added = max(0.0, math.log1p(variance / blocks) - math.log1p(variance / training_losses.blocks))
    total_variance = training_losses.log_std**2 * (1 + 1 / training_losses.motors) + added
    std = math.sqrt(max(total_variance, 1e-12))
    deviation = (np.log(losses) - training_losses.log_mean + added / 2) / std
    return student_t.sf(deviation, training_losses.motors - 1)
