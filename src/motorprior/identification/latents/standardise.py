"""Transform latents so that training motors are distributed as N(0, I).

Samples of N(0, I) then resemble the training motors. A Gaussian copula (`actuator.copula`) is put
before the decoder. It keeps the quantiles of each latent over the training motors, and the decoded
training motors stay the same. x_mi is the normal score of latent i of motor m, standardised over
the M motors. The matrix R of the correlations r_ij of these scores is shrunk, since few motors have
spurious correlations (Schäfer & Strimmer, Stat. Appl. Genet. Mol. Biol. 4, 2005):

    (1 - λ)·R + λ·I,   λ = Σ_{i≠j} Var r_ij / Σ_{i≠j} r_ij²,  at most 1
    p_mij = x_mi·x_mj
    r_ij = M/(M - 1)·mean_m p_mij
    Var r_ij = M/(M - 1)³·Σ_m (p_mij - mean_m p_mij)²

The latents of fewer than MIN_MOTORS motors are scaled by mean and standard deviation alone. The
variance of each decoder output has a scaled inverse-χ² prior that counts as PRIOR_MOTORS
observations with standard deviation s; its mean has a flat prior. One more motor then has a t
distribution. Its scale √v is used as the standard deviation (Gelman et al., Bayesian Data Analysis,
3rd ed., sections 3.2 and 3.3):

    v = (PRIOR_MOTORS·s² + Σ_i (z_i - z̄)²) / (PRIOR_MOTORS + M - 1) · (M + 1)/M

C classes of joints, of n motors each, are random effects. z̄_c is the mean over the motors of class
c. The covariance w between the units of a class is pooled over the classes:

    w = (PRIOR_MOTORS·diag s² + Σ_i (z_i - z̄_c)(z_i - z̄_c)ᵀ) / (PRIOR_MOTORS + M - C)

In this sum, an output with error variance e counts as w/(w + e) motors, since a log that does not
identify a constant does not inform about w. The mean m_c of a class is z̄_c, shrunk towards the
mean z̄ of all classes. The shrinkage depends on the variance u between classes:

    u = max(0, Σ_c (z̄_c - z̄)²/(C - 1) - w/n),   m_c = z̄ + u/(u + w/n)·(z̄_c - z̄)

A class identifies a constant if its motors count as at least MIN_WEIGHT motors. u and z̄ are
estimated from the classes that identify the constant. The mean of any other class is not shrunk: a
constant without effect, such as a very small friction, must not be drawn towards other classes.

If a log does not separate two constants, such as delay and damping, the errors of their outputs are
correlated. The covariance w keeps this correlation.
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
# minimum sum of the weights of a class's motors with which the class identifies a constant
MIN_WEIGHT = 0.5
_ROUNDS = 4  # iterations of the weights of `class_moments`
_MIN_SLOPE = 1e-6  # minimum slope of a latent over its normal score
# Standard deviation s of the logarithm of each constant; of encoder_zero in units of 0.05 rad. The
# values follow two measurements (benchmarks/unit_spread.py). Between units of a joint class of one
# quadruped, s is 0.3 for armature, 0.15 for Coulomb friction, 0.36 for delay, 0.2 for viscous
# damping, and 5 mrad for encoder zero. Between the motors of another quadruped, s is 0.1 for
# armature, 0.25 for Coulomb friction, 0.4 for delay, 0.1 for kp, and 0.03 for kd_over_kp. The other
# values are assumed. Firmware registers do not differ.
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
# Minimum standard deviation of the logarithm of a limit that no log identifies. The fit disables
# such a limit: it is four times the largest logged value
# (`motor_problem.DISABLED_LIMIT_FACTOR`). With this standard deviation, 97.6 % of the samples are
# above the largest logged value. With several classes, whose means are uncertain, it is 92 %.
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
    z: np.ndarray, class_index: np.ndarray, prior_std: np.ndarray, variance: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariance w (P, P) between the units of a class, pooled over C classes.

    Returns w, the raw means z̄_c of the classes (C, P), and the sums of the weights of their motors
    (C, P). The arguments are as for `class_moments`.
    """
    num_classes = int(class_index.max()) + 1
    is_member = np.arange(num_classes)[:, None] == class_index  # (C, M)
    prior_covariance = np.diag(prior_std**2)
    covariance = prior_covariance
    weight_sum = np.zeros(())
    raw_means = np.zeros(())

    # the weights depend on the diagonal of w, and w on the weights: iterate
    unit_variance = prior_std**2
    for _ in range(_ROUNDS):
        weight = unit_variance / np.maximum(unit_variance + variance, 1e-30)
        weight = np.broadcast_to(weight + 1e-6, z.shape)
        weight_sum = is_member @ weight
        weighted_sum = is_member @ (weight * z)
        raw_means = weighted_sum / weight_sum

        residual = np.sqrt(weight) * (z - raw_means[class_index])
        scatter = PRIOR_MOTORS * prior_covariance + residual.T @ residual
        freedom = PRIOR_MOTORS + np.maximum(weight_sum.sum(axis=0) - num_classes, 0.0)  # (P,)
        covariance = scatter / np.sqrt(np.outer(freedom, freedom))
        unit_variance = np.diag(covariance)
    return covariance, raw_means, weight_sum


def class_moments(
    z: np.ndarray, class_index: np.ndarray, prior_std: np.ndarray, variance: np.ndarray | float
) -> ClassMoments:
    """Random effects of C > 1 classes, by the formulas of the module docstring.

    The variance of a class without motors is pooled from the C - 1 degrees of freedom between the
    classes and from ASSUMED_BETWEEN, which counts as one degree of freedom.

    Args:
        z: (M, P) outputs of the motors.
        class_index: (M,) index of the class of each motor.
        prior_std: (P,) s.
        variance: (M, P) variances e of the errors of z.
    """
    covariance, raw_means, weight_sum = _pooled_covariance(z, class_index, prior_std, variance)
    num_classes = len(raw_means)

    # mean over the classes that identify a constant, or over all classes if none identifies it
    variance_of_means = np.diag(covariance) / weight_sum  # (C, P) w/n
    is_identified = weight_sum > MIN_WEIGHT
    num_identified = is_identified.sum(axis=0)
    divisor = np.maximum(num_identified, 1)
    mean_of_identified = np.sum(raw_means * is_identified, axis=0) / divisor
    mean = np.where(num_identified, mean_of_identified, raw_means.mean(axis=0))

    # variance u between classes
    squares = np.sum(is_identified * ((raw_means - mean) ** 2), axis=0)
    variance_of_raw_means = squares / np.maximum(num_identified - 1, 1)
    sampling_variance = np.sum(is_identified * variance_of_means, axis=0) / divisor
    between = np.maximum(0.0, variance_of_raw_means - sampling_variance)

    # factor u/(u + w/n) on the distance of a class mean from the mean
    shrink_factor = between / np.maximum(between + variance_of_means, 1e-30)
    shrink_factor = np.where(is_identified, shrink_factor, 1.0)

    # scale of one more unit of a class, whose mean is uncertain
    relative_variance_of_mean = np.mean(shrink_factor / np.maximum(weight_sum, 1.0), axis=0)
    scale = np.sqrt(1.0 + relative_variance_of_mean)

    # a unit of another class
    assumed_between = np.where(prior_std > 0.0, ASSUMED_BETWEEN, 0.0) ** 2
    pooled_between = (assumed_between + (num_classes - 1) * between) / num_classes
    unseen_between = pooled_between * (1.0 + 1.0 / num_classes)
    return ClassMoments(
        class_means=mean + shrink_factor * (raw_means - mean),
        mean=mean,
        covariance=covariance * np.outer(scale, scale),
        unseen_covariance=np.diag(unseen_between) + covariance,
    )


def standardised(
    model: Decoder,
    mean: np.ndarray,
    prior_std: np.ndarray | None = None,
    classes: Sequence[str] = (),
    variance: np.ndarray | float = 0.0,
    min_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, ClassLatents]:
    """Transform latents so that the units of a class are distributed as N(m, I).

    The decoded motors stay the same.

    Args:
        model: a decoder without a copula.
        mean: (M, Z) latents of the motors.
        prior_std: (Z,) assumed standard deviations s of the latents between motors. They are used
            for several classes, and for one class of fewer than MIN_MOTORS motors; if they are not
            given, the standard deviations of ``mean`` take their place.
        classes: class of each motor; one class if not given.
        variance: (M, Z) variances of the errors of ``mean``, used for several classes.
        min_std: (Z,) minimum standard deviations; 0 if not given.

    Returns:
        The model with a copula, the transformed latents (M, Z), and the classes.
    """
    motors, latents = mean.shape
    of_motors = tuple(classes) or ("",) * motors
    names = tuple(dict.fromkeys(of_motors))
    if latents == 0 or len(names) == 1:
        model, mean = _of_one_class(model, mean, prior_std, min_std)
        return model, mean, ClassLatents.with_one_class(motors, latents, names[0])

    class_index = np.array([names.index(name) for name in of_motors])
    unit_std = mean.std(axis=0) if prior_std is None else prior_std
    moments = class_moments(mean, class_index, np.maximum(unit_std, min_std), variance)
    std = np.sqrt(np.diag(moments.covariance)) + _MIN_SLOPE
    correlation = moments.covariance / np.outer(std, std) + _MIN_SLOPE * np.eye(latents)
    mixing = np.linalg.cholesky(correlation).T

    def transformed(deviations: np.ndarray) -> np.ndarray:
        """(n, Z) latents z of outputs at ``deviations`` (n, Z) from the mean."""
        return _unmixed(mixing, deviations / std)

    # covariance of a motor of an unseen class: transform the columns, then the rows
    half_transformed = transformed(moments.unseen_covariance)
    unseen_variance = np.diag(transformed(half_transformed.T))
    # not below 1, the standard deviation of the motors of a recorded class
    unseen_std = np.maximum(1.0, np.sqrt(unseen_variance))

    class_means = transformed(moments.class_means - moments.mean)
    hierarchy = ClassLatents(names, of_motors, class_means, unseen_std)
    copula = Copula(mixing, moments.mean + SCORES[:, None] * std)
    return replace(model, copula=copula), transformed(mean - moments.mean), hierarchy


def _unmixed(mixing: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """(n, Z) latents z of normal scores (n, Z): the solution of zᵀ·mixing = scores."""
    return np.linalg.solve(mixing.T, scores.T).T


def _of_one_class(
    model: Decoder, mean: np.ndarray, prior_std: np.ndarray | None, min_std: np.ndarray | float
) -> tuple[Decoder, np.ndarray]:
    """Model with a copula, and transformed latents (M, Z), of motors of one class."""
    motors, latents = mean.shape
    if latents == 0:
        return model, mean

    std = mean.std(axis=0)
    if motors < MIN_MOTORS:
        # scale of the t distribution of one more motor
        if prior_std is not None:
            scatter = np.sum((mean - mean.mean(axis=0)) ** 2, axis=0)
            pooled = (PRIOR_MOTORS * prior_std**2 + scatter) / (PRIOR_MOTORS + motors - 1)
            std = np.sqrt(pooled * (motors + 1) / motors)
        quantiles = mean.mean(axis=0) + SCORES[:, None] * std
    else:
        quantiles = np.quantile(mean, LEVELS, axis=0, method="hazen")
    # quantiles must increase, and be as wide as the minimum standard deviation
    added_std = np.maximum(_MIN_SLOPE, min_std - std)
    quantiles = quantiles + SCORES[:, None] * added_std

    scores = normal_scores(quantiles, mean)
    mixing = np.eye(latents)
    if motors >= MIN_MOTORS:
        mixing = np.linalg.cholesky(shrunk_correlation(scores)).T
    return replace(model, copula=Copula(mixing, quantiles)), _unmixed(mixing, scores)


def standard_posterior(
    model: Decoder,
    data: TrainingData,
    recipe: Recipe,
    mean: np.ndarray,
    prior_std: np.ndarray | None = None,
    min_std: np.ndarray | float = 0.0,
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """`standardised`, with the posterior variances of the transformed latents.

    Returns:
        The model with a copula, the transformed latents (M, Z), the logarithms of their
        `laplace_variance` (M, Z), and the classes.
    """
    variance = 0.0
    if len(set(data.joint_classes)) > 1 and mean.size:
        # With a prior variance of 1, 1/posterior_variance = 1/variance + 1, where ``variance`` is
        # of the fit alone. It is large where a log identifies nothing.
        posterior_variance = laplace_variance(model, data, recipe, mean)
        information_share = np.maximum(1.0 - posterior_variance, 1e-9)
        variance = posterior_variance / information_share

    model, mean, classes = standardised(
        model, mean, prior_std, data.joint_classes, variance, min_std
    )
    log_var = np.zeros_like(mean)
    if mean.size:
        log_var = np.log(laplace_variance(model, data, recipe, mean))
    return model, mean, log_var, classes


def with_scaled_spread(
    model: Decoder, mean: np.ndarray, log_var: np.ndarray, classes: ClassLatents, factor: float
) -> tuple[Decoder, np.ndarray, np.ndarray, ClassLatents]:
    """Model, latents, log-variances and classes whose samples are scaled by ``factor`` >= 1.

    Samples are scaled around the mean of a class. The decoded training motors and the means of the
    classes stay the same. A model without a copula is unchanged.
    """
    copula = model.copula
    if copula is None or factor == 1.0:
        return model, mean, log_var, classes

    median = copula.quantiles[len(SCORES) // 2]
    scaled_copula = Copula(copula.mixing, median + factor * (copula.quantiles - median))

    def with_scaled_copula(z: np.ndarray) -> np.ndarray:
        """Latents with which the scaled copula gives the same decoder latents as ``z``."""
        scores = normal_scores(scaled_copula.quantiles, copula.decoder_latents(z))
        return _unmixed(copula.mixing, scores)

    if len(classes.names) > 1:
        unseen_std = np.maximum(1.0, classes.unseen_std / factor)
        class_means = with_scaled_copula(classes.mean)
        classes = replace(classes, mean=class_means, unseen_std=unseen_std)
    scaled_log_var = log_var - 2.0 * np.log(factor)
    return replace(model, copula=scaled_copula), with_scaled_copula(mean), scaled_log_var, classes


def shrunk_correlation(x: np.ndarray) -> np.ndarray:
    """(Z, Z) correlation matrix of samples x (M, Z), shrunk towards independence.

    It is positive definite.
    """
    count, size = x.shape
    std = x.std(axis=0, ddof=1)
    standard = (x - x.mean(axis=0)) / np.where(std > 0, std, 1.0)

    # (M, Z, Z) products p: their mean gives the correlation, their variance its uncertainty
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
