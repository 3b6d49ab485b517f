"""The posterior of z for new motors, from seconds of log; the model's weights stay fixed.

    minimise  U(z) = N·loss(z)/T + ½|z - m|²/d²,     covariance = (I/d² + N·G(z)/T)⁻¹

loss is the prior's training objective, averaged over N windows that do not overlap, and G its Gauss-Newton matrix. The
temperature T is the mean loss of the training motors, so that a window fitted as well as theirs counts as one
observation (a generalised posterior with a Laplace approximation). In the covariance a motor that is fitted worse has
its own loss for T: missing physics makes its windows agree less. Mean m and standard deviation d of the prior are those
of `MotorPrior.predicted`.

`outliers` tests whether new motors lie inside the prediction interval of the M training motors. The loss of a fit alone
has little power. Every motor is therefore fitted again, with a prior PRIOR_SCALE times as wide as the training motors,
which barely shrinks the estimate. With the training motors' mean m and standard deviation s in decoder latents,

    t = (found - m) / (s·√(1 + 1/M + v)),   p = min(1, L·min over latents of P(|Student's t with M - 1| > |t|))

v·s² is the posterior variance of the second fit. p has a Bonferroni correction over the L latents in which the training
motors differ. With C classes of joints, m and M in t are those of the motor's class, s is pooled over the classes, and
t has M - C degrees of freedom, with all M training motors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.joint_classes import JointClasses
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.physics.motor_problem import MotorProblem
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.search import WIDE, Fit, GaussianPrior, Search
from motorprior.identification.windows import TrainingData

CANDIDATES, RESTARTS = 128, 16  # candidates of a search, and maximum number of restarts
STEPS = ((8, WIDE), (4, 0.5 * WIDE))  # Gauss-Newton steps of a descent, and their differences
_NOT_IDENTIFIABLE = 1e-3  # precision, over the prior's, below which a latent is not identifiable from the log
_STREAM = 47
PRIOR_SCALE = 3.0  # standard deviation of the second fit's prior over that of the training motors
_SAME = 1e-9  # up to this standard deviation of a latent, training motors differ only by rounding


@dataclass(frozen=True)
class LatentPosterior:
    """Posterior of M motors with Z latents each."""

    mean: np.ndarray  # (M, Z)
    covariance: np.ndarray  # (M, Z, Z)
    loss: np.ndarray  # (M,) mean loss per window at the mean
    windows: int  # N, windows per motor
    misfit: np.ndarray = field(default_factory=lambda: np.ones(1))  # (M,) or (1,) factor on the prior's residuals


def latent_search(model: Decoder, data: TrainingData, preset: Preset) -> Search:
    """The least-squares problems of the motors in ``data``, whose scales must be those of the model."""
    if isinstance(model, GreyBox):
        return Search(MotorProblem(model, WindowRuns(data, preset)))
    from motorprior.identification.networks.objectives import NetworkProblem

    return Search(NetworkProblem(model, data, preset))


def fit_posterior(
    model: Decoder,
    data: TrainingData,
    preset: Preset,
    temperature: float,
    start: np.ndarray | None = None,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
) -> LatentPosterior:
    """The posterior of every motor in ``data``.

    ``temperature`` is T, the mean window loss of the prior's training motors (`reference.reference_metrics`), ``start``
    (M, Z) are initial latents, found by a random search if not given, and ``prior`` are mean and standard deviation of
    z, (M, Z) each, N(0, I) if not given.
    """
    search = latent_search(model, data, preset)
    shape, windows = (search.problem.count, model.num_latents), search.problem.observations
    mean, std = prior or (np.zeros(shape), np.ones(shape))
    gaussian = GaussianPrior(mean, temperature / windows / std**2)
    found = _searched(search, gaussian, std) if start is None else search.descend(start, gaussian, STEPS)
    likelihood = _precision(search, found.x, temperature)
    hidden = np.diagonal(likelihood, axis1=1, axis2=2) * std**2 < _NOT_IDENTIFIABLE
    # damped steps end before they reach the mean
    found = found.better(search.at(np.where(hidden, mean, found.x), gaussian))
    likelihood *= (temperature / np.maximum(found.loss, temperature))[:, None, None]
    return LatentPosterior(found.x, inverse_precision(likelihood, std), found.loss, windows)


def _searched(search: Search, prior: GaussianPrior, std: np.ndarray) -> Fit:
    """Descents from samples of the prior, and from the best so far with a random half of it resampled."""
    rng, shape = np.random.default_rng(_STREAM), (len(prior.mean), CANDIDATES, prior.mean.shape[1])

    def draw(restart: int, best: Fit) -> np.ndarray:
        samples = prior.mean[:, None] + std[:, None] * rng.standard_normal(shape)
        return samples if restart % 4 == 3 else np.where(rng.random(shape) < 0.5, samples, best.x[:, None])

    mean = search.at(prior.mean, prior)
    first = search.descend(search.best_of(draw(3, mean), prior), prior, STEPS)
    return search.until_found_again(mean.better(first), prior, draw, RESTARTS, STEPS, again=4)


def laplace_variance(model: Decoder, data: TrainingData, preset: Preset, z: np.ndarray) -> np.ndarray:
    """(M, Z) diagonal of the Laplace covariance at known modes z (M, Z); the temperature is the motors' mean loss."""
    search = latent_search(model, data, preset)
    precision = _precision(search, z, float(search.losses(z).mean()))
    return np.diagonal(inverse_precision(precision, np.ones(z.shape)), axis1=1, axis2=2)


def inverse_precision(precision: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(M, Z, Z) (diag(std)⁻² + precision)⁻¹, std (M, Z), with negative eigenvalues of the scaled precision set to 0."""
    scaled = std[:, :, None] * 0.5 * (precision + precision.transpose(0, 2, 1)) * std[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    vectors = std[:, :, None] * vectors
    return np.einsum("mij,mj,mkj->mik", vectors, 1.0 / (1.0 + np.maximum(values, 0.0)), vectors)


def _precision(search: Search, z: np.ndarray, temperature: float) -> np.ndarray:
    return search.curvatures(z, WIDE) * search.problem.observations / temperature


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
    preset: Preset,
    temperature: float,
    classes: JointClasses,
    of: Sequence[str],
) -> Outliers:
    """Test each of N motors, of the classes ``of``, against the training motors of a prior's model and its ``classes``.

    ``trained`` (M, Z) are posterior means of the training motors, ``found`` (N, Z) those of the new motors, from
    `fit_posterior`; ``data``, ``preset`` and ``temperature`` are as for `fit_posterior`.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    latents = model.decoder_latents(trained)
    groups, known = [classes.rows_of(name) for name in of], [classes.rows_of(name) for name in classes.names]
    raw = np.stack([latents[rows].mean(axis=0) for rows in known])
    freedom = len(latents) - len(known)
    residual = latents - raw[[classes.names.index(name) for name in classes.of_motors]]
    std = np.maximum(np.sqrt(np.sum(residual**2, axis=0) / freedom), _SAME)
    mean, count = latents.mean(axis=0), np.array([[len(rows)] for rows in groups])
    middle = np.stack([latents[rows].mean(axis=0) for rows in groups])  # (N, Z)
    differ, scale = std > _SAME, PRIOR_SCALE * std
    wide = Copula(np.eye(len(mean)), mean + scale * SCORES[:, None])
    center = (middle - mean) / scale
    start = np.where(differ, (model.decoder_latents(found) - mean) / scale, center)
    start = np.clip(start, center - 1.0, center + 1.0)  # farther starts may be out of reach of the steps
    prior = (center, np.ones(center.shape))
    refit = fit_posterior(replace(model, copula=wide), data, preset, temperature, start=start, prior=prior)
    variance = PRIOR_SCALE**2 * np.diagonal(refit.covariance, axis1=1, axis2=2)
    away = PRIOR_SCALE * (refit.mean - center)
    t = away / np.sqrt(1.0 + 1.0 / count + variance)
    p_values = np.where(differ, 2.0 * student_t.sf(np.abs(t), freedom), 1.0)
    worst, rows = p_values.argmin(axis=1), np.arange(len(t))
    p_value = np.minimum(1.0, max(1, int(differ.sum())) * p_values[rows, worst])
    names = [f"latent {index}" for index in range(model.num_latents)]
    if isinstance(model, GreyBox) and len(model.center) == model.num_latents:  # one latent per constant
        names = parameters_of(model.terms)
    return Outliers(p_value, tuple(names[index] for index in worst), t[rows, worst], (away * std)[rows, worst])
