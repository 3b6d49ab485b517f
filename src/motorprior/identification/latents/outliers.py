"""Outlier tests by latents: whether motors lie inside the prediction interval of the training motors.

`outliers` tests new motors. The loss of a fit alone has little power, so every motor is fitted a second time, by
`fit_posterior`, with a prior PRIOR_SCALE times as wide as the training motors, which hardly shrinks the estimate. The
result, in decoder latents, is compared with the M training motors, of mean m and standard deviation s,

    t = (found - m) / (s·√(1 + 1/M + v)),   p = min(1, L·min over latents of P(|Student's t with M - 1| > |t|))

where v·s² is the posterior variance of the second fit: the prediction interval of one more motor, with a Bonferroni
correction over the L latents in which the training motors differ. `leave_one_out_outliers` tests each training motor
against the others without another fit, with M - 2 degrees of freedom and all latents.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder, MotorPrior
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

PRIOR_SCALE = 3.0  # standard deviation of the second fit's prior over that of the training motors
_SAME = 1e-9  # up to this standard deviation of a latent, training motors differ only by rounding


@dataclass(frozen=True)
class Outliers:
    """Result of the test for M motors."""

    p_value: np.ndarray  # (M,) p, the probability that one more motor of the fleet lies as far out
    latent: tuple[str, ...]  # M names, of the latent with the smallest p-value of each motor
    deviation: np.ndarray  # (M,) t of that latent


def outliers(
    model: Decoder,
    trained: np.ndarray,
    found: np.ndarray,
    data: TrainingData,
    preset: Preset,
    temperature: float,
) -> Outliers:
    """Test each of N motors against the M >= 2 training motors of a prior's model.

    ``trained`` (M, Z) are posterior means of the training motors, ``found`` (N, Z) those of the new motors, from
    `fit_posterior`; ``data``, ``preset`` and ``temperature`` are as for `fit_posterior`.
    """
    latents = model.decoder_latents(trained)
    mean, std = latents.mean(axis=0), np.maximum(latents.std(axis=0, ddof=1), _SAME)
    differ = std > _SAME
    wide = Copula(np.eye(len(mean)), mean + PRIOR_SCALE * std * SCORES[:, None])
    start = np.where(differ, (model.decoder_latents(found) - mean) / (PRIOR_SCALE * std), 0.0)
    start = np.clip(start, -1.0, 1.0)  # farther starts may be out of reach of the steps
    refit = fit_posterior(replace(model, copula=wide), data, preset, temperature, start=start)
    variance = PRIOR_SCALE**2 * np.diagonal(refit.covariance, axis1=1, axis2=2)
    t = PRIOR_SCALE * refit.mean / np.sqrt(1.0 + 1.0 / len(latents) + variance)
    p_values = np.where(differ, 2.0 * student_t.sf(np.abs(t), len(latents) - 1), 1.0)
    return _most_deviating(model, t, p_values, max(1, int(differ.sum())))


def leave_one_out_outliers(prior: MotorPrior) -> Outliers | None:
    """Test every training motor of a prior against the others; None for fewer than 4 motors, or without latents."""
    model, motors = prior.model, len(prior.mean)
    if motors < 4 or model.num_latents == 0:
        return None
    latents = model.decoder_latents(prior.mean)
    share = np.exp(prior.log_var) / np.maximum(prior.mean.var(axis=0), _SAME)  # of the variance over motors
    uncertainty = np.minimum(share, 1.0) * latents.var(axis=0)
    t = np.empty_like(latents)
    for motor in range(motors):
        others = np.delete(latents, motor, axis=0)
        variance = others.var(axis=0, ddof=1) * (1.0 + 1.0 / (motors - 1)) + uncertainty[motor]
        t[motor] = (latents[motor] - others.mean(axis=0)) / np.sqrt(np.maximum(variance, _SAME**2))
    return _most_deviating(model, t, 2.0 * student_t.sf(np.abs(t), motors - 2), model.num_latents)


def _most_deviating(model: Decoder, t: np.ndarray, p_values: np.ndarray, tests: int) -> Outliers:
    """The latent with the smallest p-value of each motor, Bonferroni-corrected for ``tests`` tests."""
    worst, names = p_values.argmin(axis=1), _latent_names(model)
    rows = np.arange(len(worst))
    p_value = np.minimum(1.0, tests * p_values[rows, worst])
    return Outliers(p_value, tuple(names[index] for index in worst), t[rows, worst])


def _latent_names(model: Decoder) -> tuple[str, ...]:
    """Names of the decoder's latents: those of the constants where each constant has its own latent."""
    if isinstance(model, GreyBox) and len(model.motor.center) == model.num_latents:
        return parameters_of(model.motor.terms)
    return tuple(f"latent {index}" for index in range(model.num_latents))
