"""Transform latents so that training motors are distributed as N(0, I), and samples of N(0, I) resemble them.

A Gaussian copula (`actuator.copula`) is put before the decoder, which does not change the training motors: each latent
keeps its quantiles over these motors, and the correlations R of the normal scores are shrunk, since samples of few
motors show spurious correlation (Schäfer & Strimmer, Stat. Appl. Genet. Mol. Biol. 4, 2005),

    (1 - λ)·R + λ·I,   λ = Σ_{i≠j} Var r_ij / Σ_{i≠j} r_ij²,  at most 1
    w_mij = x_mi·x_mj,   r_ij = n/(n - 1)·mean_m w_mij,   Var r_ij = n/(n - 1)³·Σ_m (w_mij - mean w_ij)²

for standardised scores x. The latents of fewer than MIN_MOTORS motors are scaled by mean and standard deviation alone,
with a scaled inverse-χ² prior on the variance of each decoder output, worth PRIOR_MOTORS motors with standard deviation
s, and a flat prior on its mean. One more motor then has a t distribution, whose scale √v is used (Gelman et al.,
Bayesian Data Analysis, 3rd ed., sections 3.2 and 3.3):

    v = (PRIOR_MOTORS·s² + Σ_i (z_i - z̄)²) / (PRIOR_MOTORS + M - 1) · (M + 1)/M
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.copula import LEVELS, SCORES, Copula, scores
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.latents.latent_fit import laplace_covariance, latent_search
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData
from motorprior.logs.motor_log import FIRMWARE

MIN_MOTORS = 8  # for quantiles and correlations; with fewer, these would be mostly sampling error
RELIABLE_MOTORS = 24  # for reliable samples; with fewer, outer quantiles are extrapolated
PRIOR_MOTORS = 3.0  # weight of the prior on the variance, in motors
_RISE = 1e-6  # minimum slope of a latent over its normal score
# s of the logarithm of each constant; encoder_zero in units of 0.05 rad. Gains, armature and Coulomb friction have the
# standard deviation between motors of a real quadruped; the others are assumed. Firmware registers do not differ.
ASSUMED_STD = {
    "kp": 0.1, "kd_over_kp": 0.03, "torque_limit": 0.1, "armature": 0.1, "stall_torque": 0.1, "no_load_speed": 0.05,
    "backlash": 0.4, "encoder_zero": 0.2, "integral_rate": 0.05, "integral_limit": 0.05,
} | dict.fromkeys(FIRMWARE, 0.0)  # fmt: skip
OTHER_STD = 0.25  # of every other constant: that of Coulomb friction


def assumed_std(terms: tuple[str, ...], fixed: np.ndarray) -> np.ndarray:
    """(P,) s of the outputs of a decoder with these terms; 0 of ``fixed`` (P,) constants, which are not fitted."""
    return np.where(fixed, 0.0, [ASSUMED_STD.get(name, OTHER_STD) for name in parameters_of(terms)])


def std_of_few(z: np.ndarray, assumed: np.ndarray) -> np.ndarray:
    """(P,) √v of M motors' outputs z (M, P), with ``assumed`` s (P,)."""
    motors = len(z)
    scatter = np.sum((z - z.mean(axis=0)) ** 2, axis=0)
    return np.sqrt((PRIOR_MOTORS * assumed**2 + scatter) / (PRIOR_MOTORS + motors - 1) * (motors + 1) / motors)


def standardised(model: Decoder, mean: np.ndarray, assumed: np.ndarray | None = None) -> tuple[Decoder, np.ndarray]:
    """Transform latents so that the training motors are distributed as N(0, I); the decoded motors stay the same.

    ``mean`` (M, Z) are their latents in a model without a copula, ``assumed`` (Z,) the assumed standard deviations,
    used for few motors, 0 if not given.
    """
    motors, latents = mean.shape
    if latents == 0:
        return model, mean
    if motors < MIN_MOTORS:
        std = mean.std(axis=0) if assumed is None else std_of_few(mean, assumed)
        quantiles = mean.mean(axis=0) + SCORES[:, None] * std
    else:
        quantiles = np.quantile(mean, LEVELS, axis=0, method="hazen")
    quantiles = quantiles + _RISE * SCORES[:, None]
    normal = scores(quantiles, mean)
    mixing = np.eye(latents) if motors < MIN_MOTORS else np.linalg.cholesky(shrunk_correlation(normal)).T
    return replace(model, copula=Copula(mixing, quantiles)), np.linalg.solve(mixing.T, normal.T).T


def standard_posterior(
    model: Decoder, data: TrainingData, preset: Preset, mean: np.ndarray, assumed: np.ndarray | None = None
) -> tuple[Decoder, np.ndarray, np.ndarray]:
    """`standardised` model and means, and log-variances (M, Z).

    The variances are the diagonal of `fit_posterior`'s Laplace approximation; the temperature is the motors' mean loss.
    """
    model, mean = standardised(model, mean, assumed)
    if mean.size == 0:
        return model, mean, np.zeros_like(mean)
    search = latent_search(model, data, preset)
    covariance = laplace_covariance(search, mean, float(search.losses(mean).mean()))
    return model, mean, np.log(np.diagonal(covariance, axis1=1, axis2=2))


def with_scaled_spread(
    model: Decoder, mean: np.ndarray, log_var: np.ndarray, factor: float
) -> tuple[Decoder, np.ndarray, np.ndarray]:
    """Network, latents and log-variances with samples scaled around the central motor by ``factor`` >= 1.

    The decoded training motors stay the same; a model without a copula is unchanged.
    """
    copula = model.copula
    if copula is None or factor == 1.0:
        return model, mean, log_var
    latents, middle = copula.decoder_latents(mean), copula.quantiles[len(SCORES) // 2]
    wide = Copula(copula.mixing, middle + factor * (copula.quantiles - middle))
    normal = scores(wide.quantiles, latents)
    moved = np.linalg.solve(copula.mixing.T, normal.T).T
    return replace(model, copula=wide), moved, log_var - 2.0 * np.log(factor)


def shrunk_correlation(x: np.ndarray) -> np.ndarray:
    """(Z, Z) correlation matrix of (M, Z) samples, shrunk towards independence; positive definite."""
    count, size = x.shape
    std = x.std(axis=0, ddof=1)
    standard = (x - x.mean(axis=0)) / np.where(std > 0, std, 1.0)
    products = standard[:, :, None] * standard[:, None, :]
    off_diagonal = ~np.eye(size, dtype=bool)
    variance = count / (count - 1) ** 3 * np.sum((products - products.mean(axis=0)) ** 2, axis=0)
    correlation = count / (count - 1) * products.mean(axis=0)
    total = np.sum(correlation[off_diagonal] ** 2)
    shrinkage = min(1.0, float(np.sum(variance[off_diagonal]) / total)) if total > 0 else 1.0
    return np.where(off_diagonal, (1.0 - shrinkage) * correlation, 1.0)
