"""Transform latents so that training motors are distributed as N(0, I), and samples of N(0, I) resemble them.

A Gaussian copula (`actuator.copula`) is put before the decoder; the training motors stay the same.
Each latent keeps its quantiles over these motors. The correlations R of the normal scores are
shrunk, since few motors show spurious correlation (Schäfer & Strimmer, Stat. Appl. Genet. Mol.
Biol. 4, 2005),

    (1 - λ)·R + λ·I,   λ = Σ_{i≠j} Var r_ij / Σ_{i≠j} r_ij²,  at most 1
    w_mij = x_mi·x_mj,   r_ij = n/(n - 1)·mean_m w_mij,   Var r_ij = n/(n - 1)³·Σ_m (w_mij - mean w_ij)²

for standardised scores x.

The latents of fewer than MIN_MOTORS motors are scaled by mean and standard deviation alone. The
variance of each decoder output has a scaled inverse-χ² prior that counts as PRIOR_MOTORS
observations with standard deviation s; its mean has a flat prior. One more motor then has a t
distribution, whose scale √v is used (Gelman et al., Bayesian Data Analysis, 3rd ed., sections 3.2
and 3.3):

    v = (PRIOR_MOTORS·s² + Σ_i (z_i - z̄)²) / (PRIOR_MOTORS + M - 1) · (M + 1)/M

C classes of joints, of n motors each, are random effects. With the raw means z̄_c, the covariance
between the units of a class is pooled over the classes:

    w = (PRIOR_MOTORS·diag s² + Σ_i (z_i - z̄_c)(z_i - z̄_c)ᵀ) / (PRIOR_MOTORS + M - C)

A latent with error variance e counts as w/(w + e) motors, since a constant that a log does not
identify does not inform about w. The mean m_c of a class is shrunk towards that of all classes,
with the variance u between classes:

    u = max(0, Σ_c (z̄_c - z̄)²/(C - 1) - w/n),   m_c = z̄ + u/(u + w/n)·(z̄_c - z̄)

u uses the classes that identify the constant, with n of at least MIN_UNITS. Others keep their own
mean: a constant without effect, such as a very small friction, must not become that of other
classes.

The covariance w keeps directions in which logs do not separate constants, such as delay and
damping.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.copula import LEVELS, SCORES, Copula, normal_scores
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.latents.latent_fit import laplace_variance
from motorprior.identification.physics.motor_fit import ASSUMED_BETWEEN
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData
from motorprior.logs.motor_log import FIRMWARE

MIN_MOTORS = 8  # minimum for quantiles and correlations; with fewer these are mostly sampling error
RELIABLE_MOTORS = 24  # minimum for reliable samples; with fewer outer quantiles are extrapolated
PRIOR_MOTORS = 3.0  # observations that the prior on the variance counts as
# sum of the weights of a class's motors; with less, a constant's mean in the class is not shrunk
MIN_UNITS = 0.5
_ROUNDS = 4  # iterations of the weights of `class_moments`
_RISE = 1e-6  # minimum slope of a latent over its normal score
# s of the logarithm of each constant; encoder_zero in units of 0.05 rad. Measured between units of
# a class of joints of one quadruped, and between the motors of another (benchmarks/unit_spread.py):
# armature 0.3 and 0.1, Coulomb friction 0.15 and 0.25, delay 0.36 and 0.4; of the first, viscous
# damping 0.2, encoder zero 5 mrad; of the second, kp 0.1 and kd_over_kp 0.03. The others are
# assumed. Firmware registers do not differ.
ASSUMED_STD = {
    "kp": 0.1, "kd_over_kp": 0.03, "torque_limit": 0.1, "armature": 0.2, "stall_torque": 0.1, "no_load_speed": 0.05,
    "backlash": 0.4, "encoder_zero": 0.1, "delay": 0.4, "coulomb": 0.2, "viscous_damping": 0.2, "integral_rate": 0.05,
    "integral_limit": 0.05,
} | dict.fromkeys(FIRMWARE, 0.0)  # fmt: skip
# Minimum standard deviation of the logarithm of a limit that no log shows. It is off, at four times
# what the logs reach (`motor_fit`): 97.6 % of samples are above what they reach, with several
# classes 92 %, as their means are uncertain.
LIMIT_STD = 0.7
OTHER_STD = 0.25  # standard deviation of the logarithm of other constants: that of Coulomb friction
ASSUMED_SOURCE = (
    "units of the joint classes of one quadruped and motors of another (benchmarks/unit_spread.py)"
)


def assumed_std(terms: tuple[str, ...], fixed: np.ndarray) -> np.ndarray:
    """(P,) s of the outputs of a decoder with these terms; 0 of ``fixed`` (P,) constants, which are not fitted."""
    return np.where(fixed, 0.0, [ASSUMED_STD.get(name, OTHER_STD) for name in parameters_of(terms)])


def spread_source(model: Decoder, classes: ClassLatents) -> dict[str, Any]:
    """Where the spread between units comes from, for the provenance of a prior: what is measured, pooled, assumed."""
    motors = len(classes.of_motors)
    count = len(classes.names)
    units = {name: classes.of_motors.count(name) for name in classes.names}
    found = {
        "units": units,
        "degrees_of_freedom": motors - count,
        "assumed": {},
        "assumed_units": 0.0,
        "source": "",
    }
    if isinstance(model, GreyBox) and (count > 1 or motors < MIN_MOTORS):
        names = parameters_of(model.terms)
        assumed = {name: ASSUMED_STD.get(name, OTHER_STD) for name in names}
        found |= {"assumed": assumed, "assumed_units": PRIOR_MOTORS, "source": ASSUMED_SOURCE}
    return found


def class_moments(
    z: np.ndarray, row: np.ndarray, assumed: np.ndarray, variance: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Random effects of C > 1 classes: outputs z (M, P) of motors of the classes ``row`` (M,), ``assumed`` s (P,).

    The formulas of the module docstring, with the errors' ``variance`` (M, P) of z; ASSUMED_BETWEEN
    counts as one class in the variance of a class without motors. Returns the means of the classes
    (C, P) and of all (P,), and the covariances (P, P) of one more unit around the mean of its
    class, and of a unit of another class around that of all.
    """
    classes = np.arange(int(row.max()) + 1)[:, None] == row
    units = np.diag(assumed**2)
    v = assumed**2
    count = np.zeros(())
    raw = np.zeros(())
    for _ in range(_ROUNDS):
        weight = np.broadcast_to(v / np.maximum(v + variance, 1e-30) + 1e-6, z.shape)
        count = classes @ weight  # (C, P)
        raw = classes @ (weight * z) / count
        residual = np.sqrt(weight) * (z - raw[row])
        freedom = PRIOR_MOTORS + np.maximum(count.sum(axis=0) - len(classes), 0.0)
        units = PRIOR_MOTORS * np.diag(assumed**2) + residual.T @ residual
        units /= np.sqrt(np.outer(freedom, freedom))
        v = np.diag(units)
    # (C, P) variance of the mean of a class
    noise = v / count
    identified = count > MIN_UNITS
    classes_used = identified.sum(axis=0)
    center = np.where(
        classes_used,
        np.sum(raw * identified, axis=0) / np.maximum(classes_used, 1),
        raw.mean(axis=0),
    )
    between = np.sum(identified * ((raw - center) ** 2), axis=0) / np.maximum(classes_used - 1, 1)
    u = np.maximum(0.0, between - np.sum(identified * noise, axis=0) / np.maximum(classes_used, 1))
    share = np.where(identified, u / np.maximum(u + noise, 1e-30), 1.0)
    assumed_between = np.where(assumed > 0.0, ASSUMED_BETWEEN, 0.0) ** 2
    wide = (assumed_between + (len(classes) - 1) * u) / len(classes) * (1.0 + 1.0 / len(classes))
    scale = np.sqrt(1.0 + np.mean(share / np.maximum(count, 1.0), axis=0))
    return (
        center + share * (raw - center),
        center,
        units * np.outer(scale, scale),
        np.diag(wide) + units,
    )


def standardised(
    model: Decoder,
    mean: np.ndarray,
    assumed: np.ndarray | None = None,
    classes: Sequence[str] = (),
    variance: np.ndarray | float = 0.0,
    least_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, ClassLatents]:
    """Transform latents so that the units of a class are distributed as N(m, I); the decoded motors stay the same.

    ``mean`` (M, Z) are their latents in a model without a copula, ``assumed`` (Z,) the assumed
    standard deviations, used for few motors, 0 if not given, ``classes`` those of the motors, one
    if not given, ``variance`` (M, Z) that of the means' errors, used for several classes, and
    ``least_std`` (Z,) minimum standard deviations, 0 if not given.
    """
    motors, latents = mean.shape
    of_motors = tuple(classes) or ("",) * motors
    names = tuple(dict.fromkeys(of_motors))
    if latents == 0 or len(names) == 1:
        return *_of_one_class(model, mean, assumed, least_std), ClassLatents.one(
            motors, latents, names[0]
        )
    row = np.array([names.index(name) for name in of_motors])
    prior_std = mean.std(axis=0) if assumed is None else assumed
    middle, center, units, unseen = class_moments(
        mean, row, np.maximum(prior_std, least_std), variance
    )
    std = np.sqrt(np.diag(units)) + _RISE
    mixing = np.linalg.cholesky(units / np.outer(std, std) + _RISE * np.eye(latents)).T

    def standard(values: np.ndarray) -> np.ndarray:
        return np.linalg.solve(mixing.T, (values / std).T).T

    unseen_std = np.maximum(1.0, np.sqrt(np.diag(standard(standard(unseen).T))))
    hierarchy = ClassLatents(names, of_motors, standard(middle - center), unseen_std)
    copula = Copula(mixing, center + SCORES[:, None] * std)
    return replace(model, copula=copula), standard(mean - center), hierarchy


def _of_one_class(
    model: Decoder, mean: np.ndarray, assumed: np.ndarray | None, least_std: np.ndarray | float
) -> tuple[Decoder, np.ndarray]:
    motors, latents = mean.shape
    if latents == 0:
        return model, mean
    std = mean.std(axis=0)
    if motors < MIN_MOTORS:
        scatter = np.sum((mean - mean.mean(axis=0)) ** 2, axis=0)
        if assumed is not None:
            v = (
                (PRIOR_MOTORS * assumed**2 + scatter)
                / (PRIOR_MOTORS + motors - 1)
                * (motors + 1)
                / motors
            )
            std = np.sqrt(v)
        quantiles = mean.mean(axis=0) + SCORES[:, None] * std
    else:
        quantiles = np.quantile(mean, LEVELS, axis=0, method="hazen")
    quantiles = quantiles + SCORES[:, None] * np.maximum(_RISE, least_std - std)
    normal = normal_scores(quantiles, mean)
    mixing = (
        np.eye(latents) if motors < MIN_MOTORS else np.linalg.cholesky(shrunk_correlation(normal)).T
    )
    return replace(model, copula=Copula(mixing, quantiles)), np.linalg.solve(mixing.T, normal.T).T


def standard_posterior(
    model: Decoder,
    data: TrainingData,
    recipe: Recipe,
    mean: np.ndarray,
    assumed: np.ndarray | None = None,
    least_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """`standardised` model, means, log of the `laplace_variance` (M, Z) of the means, and classes."""
    variance = 0.0
    if len(set(data.joint_classes)) > 1 and mean.size:
        share = laplace_variance(model, data, recipe, mean)  # of a prior with variance 1
        # of the fit alone; large where a log identifies nothing
        variance = share / np.maximum(1.0 - share, 1e-9)
    model, mean, classes = standardised(
        model, mean, assumed, data.joint_classes, variance, least_std
    )
    if mean.size == 0:
        return model, mean, np.zeros_like(mean), classes
    return model, mean, np.log(laplace_variance(model, data, recipe, mean)), classes


def with_scaled_spread(
    model: Decoder, mean: np.ndarray, log_var: np.ndarray, classes: ClassLatents, factor: float
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """Model, latents, log-variances and classes with samples scaled around the mean of a class by ``factor`` >= 1.

    The decoded training motors and means of classes stay the same; a model without a copula is
    unchanged.
    """
    copula = model.copula
    if copula is None or factor == 1.0:
        return model, mean, log_var, classes
    middle = copula.quantiles[len(SCORES) // 2]
    wide = Copula(copula.mixing, middle + factor * (copula.quantiles - middle))

    def moved(z: np.ndarray) -> np.ndarray:
        normal = normal_scores(wide.quantiles, copula.decoder_latents(z))
        return np.linalg.solve(copula.mixing.T, normal.T).T

    if len(classes.names) > 1:
        unseen = np.maximum(1.0, classes.unseen_std / factor)
        classes = replace(classes, mean=moved(classes.mean), unseen_std=unseen)
    return replace(model, copula=wide), moved(mean), log_var - 2.0 * np.log(factor), classes


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
