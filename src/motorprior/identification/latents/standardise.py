"""Transform latents so that training motors are distributed as N(0, I).

Samples of N(0, I) then resemble the training motors. A Gaussian copula (`actuator.copula`) is put
before the decoder; the training motors stay the same. Each latent keeps its quantiles over these
motors. The correlations R of the normal scores x, standardised, are shrunk, since few motors have
spurious correlation (Schäfer & Strimmer, Stat. Appl. Genet. Mol. Biol. 4, 2005):

    (1 - λ)·R + λ·I,   λ = Σ_{i≠j} Var r_ij / Σ_{i≠j} r_ij²,  at most 1
    w_mij = x_mi·x_mj
    r_ij = n/(n - 1)·mean_m w_mij
    Var r_ij = n/(n - 1)³·Σ_m (w_mij - mean w_ij)²

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
identify does not inform about w. The mean m_c of a class is shrunk towards the mean of all classes,
with the variance u between classes:

    u = max(0, Σ_c (z̄_c - z̄)²/(C - 1) - w/n),   m_c = z̄ + u/(u + w/n)·(z̄_c - z̄)

u uses the classes that identify the constant, with n of at least MIN_UNITS. Other classes keep
their own mean: a constant without effect, such as a very small friction, must not be drawn towards
other classes.

The covariance w keeps directions in which logs do not separate constants, such as delay and
damping.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.copula import LEVELS, SCORES, Copula, normal_scores
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.latents.latent_fit import laplace_variance
from motorprior.identification.physics.population_fit import ASSUMED_BETWEEN
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData
from motorprior.logs.motor_log import FIRMWARE

# minimum for quantiles and correlations; with fewer motors these are mostly sampling error
MIN_MOTORS = 8
# minimum for reliable samples; with fewer motors outer quantiles are extrapolated
RELIABLE_MOTORS = 24
# observations that the prior on the variance counts as
PRIOR_MOTORS = 3.0
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
    "kp": 0.1,
    "kd_over_kp": 0.03,
    "torque_limit": 0.1,
    "armature": 0.2,
    "stall_torque": 0.1,
    "no_load_speed": 0.05,
    "backlash": 0.4,
    "encoder_zero": 0.1,
    "delay": 0.4,
    "coulomb": 0.2,
    "viscous_damping": 0.2,
    "integral_rate": 0.05,
    "integral_limit": 0.05,
    **dict.fromkeys(FIRMWARE, 0.0),
}
OTHER_STD = 0.25  # s of the logarithm of other constants, as for Coulomb friction of one quadruped
# Minimum standard deviation of the logarithm of a limit that no log identifies. It is off, at four
# times what the logs reach (`motor_problem.OFF`): 97.6 % of samples are above what they reach, with
# several classes 92 %, as their means are uncertain.
UNIDENTIFIED_LIMIT_STD = 0.7
ASSUMED_SOURCE = (
    "units of the joint classes of one quadruped and motors of another (benchmarks/unit_spread.py)"
)


def assumed_std(terms: tuple[str, ...], fixed: np.ndarray) -> np.ndarray:
    """(P,) s of the outputs of a decoder with these terms.

    It is 0 for ``fixed`` (P,) constants, which are not fitted.
    """
    std = [ASSUMED_STD.get(name, OTHER_STD) for name in parameters_of(terms)]
    return np.where(fixed, 0.0, std)


def spread_source(model: Decoder, classes: ClassLatents) -> dict[str, Any]:
    """Where the spread between units comes from, for the provenance of a prior.

    The entries state the number of units, the degrees of freedom, and what is assumed.
    """
    motors = len(classes.of_motors)
    count = len(classes.names)
    source = {
        "units": {name: classes.of_motors.count(name) for name in classes.names},
        "degrees_of_freedom": motors - count,
        "assumed": {},
        "assumed_units": 0.0,
        "source": "",
    }
    uses_assumed_std = count > 1 or motors < MIN_MOTORS
    if isinstance(model, GreyBox) and uses_assumed_std:
        names = parameters_of(model.terms)
        source["assumed"] = {name: ASSUMED_STD.get(name, OTHER_STD) for name in names}
        source["assumed_units"] = PRIOR_MOTORS
        source["source"] = ASSUMED_SOURCE
    return source


@dataclass(frozen=True)
class ClassMoments:
    """Means and covariances of the units of C classes."""

    class_means: np.ndarray  # (C, P)
    mean: np.ndarray  # (P,) of all classes
    covariance: np.ndarray  # (P, P) of one more unit of a class around the mean of the class
    unseen_covariance: np.ndarray  # (P, P) of a unit of another class around the mean of all


def _pooled_covariance(
    z: np.ndarray, row: np.ndarray, assumed: np.ndarray, variance: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariance w (P, P) between the units of a class, pooled over C classes.

    Returns w, the raw means of the classes (C, P), and the sums of the weights of their motors
    (C, P). Arguments as for `class_moments`.
    """
    members = np.arange(int(row.max()) + 1)[:, None] == row  # (C, M)
    prior_covariance = np.diag(assumed**2)
    covariance = prior_covariance
    count = np.zeros(())
    raw_means = np.zeros(())

    # the diagonal of w weights the motors, so w is iterated
    unit_variance = assumed**2
    for _ in range(_ROUNDS):
        weight = unit_variance / np.maximum(unit_variance + variance, 1e-30) + 1e-6
        weight = np.broadcast_to(weight, z.shape)
        count = members @ weight
        raw_means = members @ (weight * z) / count
        residual = np.sqrt(weight) * (z - raw_means[row])
        freedom = PRIOR_MOTORS + np.maximum(count.sum(axis=0) - len(members), 0.0)
        covariance = PRIOR_MOTORS * prior_covariance + residual.T @ residual
        covariance /= np.sqrt(np.outer(freedom, freedom))
        unit_variance = np.diag(covariance)
    return covariance, raw_means, count


def class_moments(
    z: np.ndarray, row: np.ndarray, assumed: np.ndarray, variance: np.ndarray | float
) -> ClassMoments:
    """Random effects of C > 1 classes, by the formulas of the module docstring.

    ASSUMED_BETWEEN counts as one class in the variance of a class without motors.

    Args:
        z: (M, P) outputs of the motors.
        row: (M,) index of the class of each motor.
        assumed: (P,) s.
        variance: (M, P) of the errors of z.
    """
    covariance, raw_means, count = _pooled_covariance(z, row, assumed, variance)
    num_classes = len(raw_means)

    # mean of the classes that identify a constant, or of all classes if none does
    mean_variance = np.diag(covariance) / count  # (C, P) of the means of the classes
    identified = count > MIN_UNITS
    num_identified = identified.sum(axis=0)
    divisor = np.maximum(num_identified, 1)
    mean_of_identified = np.sum(raw_means * identified, axis=0) / divisor
    mean = np.where(num_identified, mean_of_identified, raw_means.mean(axis=0))

    # variance u between classes, and how far the means are shrunk
    squares = np.sum(identified * ((raw_means - mean) ** 2), axis=0)
    sampling = np.sum(identified * mean_variance, axis=0) / divisor
    between = np.maximum(0.0, squares / np.maximum(num_identified - 1, 1) - sampling)
    kept = between / np.maximum(between + mean_variance, 1e-30)
    kept = np.where(identified, kept, 1.0)

    # one more unit of a class, and a unit of another class
    scale = np.sqrt(1.0 + np.mean(kept / np.maximum(count, 1.0), axis=0))
    assumed_between = np.where(assumed > 0.0, ASSUMED_BETWEEN, 0.0) ** 2
    pooled_between = (assumed_between + (num_classes - 1) * between) / num_classes
    unseen_between = pooled_between * (1.0 + 1.0 / num_classes)
    return ClassMoments(
        class_means=mean + kept * (raw_means - mean),
        mean=mean,
        covariance=covariance * np.outer(scale, scale),
        unseen_covariance=np.diag(unseen_between) + covariance,
    )


def standardised(
    model: Decoder,
    mean: np.ndarray,
    assumed: np.ndarray | None = None,
    classes: Sequence[str] = (),
    variance: np.ndarray | float = 0.0,
    min_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, ClassLatents]:
    """Transform latents so that the units of a class are distributed as N(m, I).

    The decoded motors stay the same.

    Args:
        model: a decoder without a copula.
        mean: (M, Z) latents of the motors.
        assumed: (Z,) assumed standard deviations, used for few motors; 0 if not given.
        classes: class of each motor; one class if not given.
        variance: (M, Z) of the errors of ``mean``, used for several classes.
        min_std: (Z,) minimum standard deviations; 0 if not given.

    Returns:
        The model, the transformed latents (M, Z), and the classes.
    """
    motors, latents = mean.shape
    of_motors = tuple(classes) or ("",) * motors
    names = tuple(dict.fromkeys(of_motors))
    if latents == 0 or len(names) == 1:
        model, mean = _of_one_class(model, mean, assumed, min_std)
        return model, mean, ClassLatents.one(motors, latents, names[0])

    row = np.array([names.index(name) for name in of_motors])
    prior_std = mean.std(axis=0) if assumed is None else assumed
    moments = class_moments(mean, row, np.maximum(prior_std, min_std), variance)
    std = np.sqrt(np.diag(moments.covariance)) + _RISE
    correlation = moments.covariance / np.outer(std, std) + _RISE * np.eye(latents)
    mixing = np.linalg.cholesky(correlation).T

    def standard(values: np.ndarray) -> np.ndarray:
        return np.linalg.solve(mixing.T, (values / std).T).T

    # of a class without motors, at least as wide as a known one
    unseen_variance = np.diag(standard(standard(moments.unseen_covariance).T))
    unseen_std = np.maximum(1.0, np.sqrt(unseen_variance))
    class_means = standard(moments.class_means - moments.mean)
    hierarchy = ClassLatents(names, of_motors, class_means, unseen_std)
    copula = Copula(mixing, moments.mean + SCORES[:, None] * std)
    return replace(model, copula=copula), standard(mean - moments.mean), hierarchy


def _of_one_class(
    model: Decoder, mean: np.ndarray, assumed: np.ndarray | None, min_std: np.ndarray | float
) -> tuple[Decoder, np.ndarray]:
    """Model with a copula, and transformed latents (M, Z), of motors of one class."""
    motors, latents = mean.shape
    if latents == 0:
        return model, mean

    std = mean.std(axis=0)
    if motors < MIN_MOTORS:
        # the t distribution of one more motor
        scatter = np.sum((mean - mean.mean(axis=0)) ** 2, axis=0)
        if assumed is not None:
            pooled = (PRIOR_MOTORS * assumed**2 + scatter) / (PRIOR_MOTORS + motors - 1)
            std = np.sqrt(pooled * (motors + 1) / motors)
        quantiles = mean.mean(axis=0) + SCORES[:, None] * std
    else:
        quantiles = np.quantile(mean, LEVELS, axis=0, method="hazen")
    # quantiles must rise, and be as wide as the minimum standard deviation
    quantiles = quantiles + SCORES[:, None] * np.maximum(_RISE, min_std - std)

    scores = normal_scores(quantiles, mean)
    mixing = np.eye(latents)
    if motors >= MIN_MOTORS:
        mixing = np.linalg.cholesky(shrunk_correlation(scores)).T
    latent_mean = np.linalg.solve(mixing.T, scores.T).T
    return replace(model, copula=Copula(mixing, quantiles)), latent_mean


def standard_posterior(
    model: Decoder,
    data: TrainingData,
    recipe: Recipe,
    mean: np.ndarray,
    assumed: np.ndarray | None = None,
    min_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """`standardised` model, means and classes, and the logarithm of their `laplace_variance`.

    Returns:
        The model, means (M, Z), logarithms of the variances (M, Z) of the means, and classes.
    """
    variance = 0.0
    if len(set(data.joint_classes)) > 1 and mean.size:
        # posterior variance under a prior with variance 1
        posterior = laplace_variance(model, data, recipe, mean)
        # of the fit alone; large where a log identifies nothing
        variance = posterior / np.maximum(1.0 - posterior, 1e-9)

    model, mean, classes = standardised(model, mean, assumed, data.joint_classes, variance, min_std)
    log_var = np.zeros_like(mean)
    if mean.size:
        log_var = np.log(laplace_variance(model, data, recipe, mean))
    return model, mean, log_var, classes


def with_scaled_spread(
    model: Decoder, mean: np.ndarray, log_var: np.ndarray, classes: ClassLatents, factor: float
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """Model, latents, log-variances and classes with samples scaled by ``factor`` >= 1.

    Samples are scaled around the mean of a class. The decoded training motors and means of classes
    stay the same; a model without a copula is unchanged.
    """
    copula = model.copula
    if copula is None or factor == 1.0:
        return model, mean, log_var, classes

    median = copula.quantiles[len(SCORES) // 2]
    scaled = Copula(copula.mixing, median + factor * (copula.quantiles - median))

    def moved(z: np.ndarray) -> np.ndarray:
        """Latents of the same decoder latents with the scaled copula."""
        scores = normal_scores(scaled.quantiles, copula.decoder_latents(z))
        return np.linalg.solve(copula.mixing.T, scores.T).T

    if len(classes.names) > 1:
        unseen_std = np.maximum(1.0, classes.unseen_std / factor)
        classes = replace(classes, mean=moved(classes.mean), unseen_std=unseen_std)
    return replace(model, copula=scaled), moved(mean), log_var - 2.0 * np.log(factor), classes


def shrunk_correlation(x: np.ndarray) -> np.ndarray:
    """(Z, Z) correlation matrix of samples x (M, Z), shrunk towards independence.

    It is positive definite.
    """
    count, size = x.shape
    std = x.std(axis=0, ddof=1)
    standard = (x - x.mean(axis=0)) / np.where(std > 0, std, 1.0)

    # (M, Z, Z) products w, whose mean is the correlation and whose variance is its uncertainty
    products = standard[:, :, None] * standard[:, None, :]
    correlation = count / (count - 1) * products.mean(axis=0)
    squares = np.sum((products - products.mean(axis=0)) ** 2, axis=0)
    variance = count / (count - 1) ** 3 * squares

    off_diagonal = ~np.eye(size, dtype=bool)
    total = np.sum(correlation[off_diagonal] ** 2)
    shrinkage = 1.0
    if total > 0:
        shrinkage = min(1.0, float(np.sum(variance[off_diagonal]) / total))
    return np.where(off_diagonal, (1.0 - shrinkage) * correlation, 1.0)
