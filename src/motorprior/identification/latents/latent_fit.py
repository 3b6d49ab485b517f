"""The posterior of z for new motors, from seconds of log; the model's weights stay fixed.

    minimise  U(z) = N·loss(z)/T + ½|z - m|²/d²,     covariance = (I/d² + N·G(z)/T)⁻¹

loss is the prior's training objective, averaged over N windows that do not overlap, and G its
Gauss-Newton matrix. The temperature T is the mean loss of the training motors, so that a window
that is fitted as well as their windows counts as one observation (a generalised posterior with a
Laplace approximation). If a motor is fitted worse than the training motors, T in its covariance is
its own loss: physics that the model lacks makes its windows agree less. `MotorPrior.predicted`
gives the mean m and the standard deviation d of the prior.
"""

from dataclasses import dataclass, field

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.physics.motor_problem import MotorProblem
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.search import WIDE, Fit, GaussianPrior, Search
from motorprior.identification.windows import TrainingData

CANDIDATES = 128  # candidates of a search
RESTARTS = 16  # maximum number
_CONFIRMATIONS = 4  # times that the best optimum must be found again
STEPS = ((8, WIDE), (4, 0.5 * WIDE))  # Gauss-Newton steps of a descent, and their differences
# A latent is not identifiable from the log if its precision, relative to the prior's, is below
# this.
_NOT_IDENTIFIABLE = 1e-3
_STREAM = 47


@dataclass(frozen=True)
class LatentPosterior:
    """Posterior of M motors with Z latents each."""

    mean: np.ndarray  # (M, Z)
    covariance: np.ndarray  # (M, Z, Z)
    loss: np.ndarray  # (M,) mean loss per window at the mean
    windows: int  # N, windows per motor
    # (M,) or (1,) factor on the prior's residuals
    misfit: np.ndarray = field(default_factory=lambda: np.ones(1))
    # (M,) or (1,) whether a motor has the prior's distribution: its log does not show the motor,
    # and its loss is not that of the mean
    keeps_prior: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=bool))


def latent_search(model: Decoder, data: TrainingData, recipe: Recipe) -> Search:
    """Search for the latents of the motors in ``data``, which must have the scales of the model."""
    if isinstance(model, GreyBox):
        return Search(MotorProblem(model, WindowRuns(data, recipe)))
    from motorprior.identification.networks.objectives import NetworkProblem

    return Search(NetworkProblem(model, data, recipe))


def fit_posterior(
    model: Decoder,
    data: TrainingData,
    recipe: Recipe,
    temperature: float,
    start: np.ndarray | None = None,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
) -> LatentPosterior:
    """The posterior of every motor in ``data``.

    Args:
        model: decoder of the prior.
        data: logs of M motors, with the scales of the model.
        recipe: recipe of the prior.
        temperature: T, the mean window loss of the prior's training motors
            (`evaluation.training_errors.loss_statistics`).
        start: (M, Z) initial latents; a random search finds them if they are not given.
        prior: mean and standard deviation of z, (M, Z) each; N(0, I) if not given.
    """
    search = latent_search(model, data, recipe)
    shape = (search.problem.count, model.num_latents)
    windows = search.problem.observations
    mean, std = prior or (np.zeros(shape), np.ones(shape))
    gaussian = GaussianPrior(mean, temperature / windows / std**2)
    if start is None:
        fit = _searched(search, gaussian, std)
    else:
        fit = search.descend(start, gaussian, STEPS)
    likelihood = _precision(search, fit.x, temperature)  # (M, Z, Z)

    # latents that the log does not identify get the mean of the prior: damped steps end before
    # they reach it
    information = np.diagonal(likelihood, axis1=1, axis2=2) * std**2
    is_hidden = information < _NOT_IDENTIFIABLE
    fit = fit.better(search.at(np.where(is_hidden, mean, fit.x), gaussian))

    # a motor that is fitted worse than the training motors has its own temperature
    likelihood *= (temperature / np.maximum(fit.loss, temperature))[:, None, None]
    return LatentPosterior(fit.x, inverse_precision(likelihood, std), fit.loss, windows)


def _searched(search: Search, prior: GaussianPrior, std: np.ndarray) -> Fit:
    """Fit by descents from samples of the prior.

    Three of four restarts keep a random half of the best latents so far.
    """
    rng = np.random.default_rng(_STREAM)
    shape = (len(prior.mean), CANDIDATES, prior.mean.shape[1])

    def sampled() -> np.ndarray:
        return prior.mean[:, None] + std[:, None] * rng.standard_normal(shape)

    def draw(restart: int, best: Fit) -> np.ndarray:
        samples = sampled()
        if restart % 4 == 3:
            return samples
        return np.where(rng.random(shape) < 0.5, samples, best.x[:, None])

    mean = search.at(prior.mean, prior)
    first = search.descend(search.best_of(sampled(), prior), prior, STEPS)
    return search.until_found_again(
        mean.better(first), prior, draw, RESTARTS, STEPS, confirmations=_CONFIRMATIONS
    )


def laplace_variance(
    model: Decoder, data: TrainingData, recipe: Recipe, z: np.ndarray
) -> np.ndarray:
    """(M, Z) diagonal of the Laplace covariance at the modes z (M, Z).

    The temperature is the mean loss of the motors.
    """
    search = latent_search(model, data, recipe)
    precision = _precision(search, z, float(search.losses(z).mean()))
    covariance = inverse_precision(precision, np.ones(z.shape))
    return np.diagonal(covariance, axis1=1, axis2=2)


def inverse_precision(precision: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(M, Z, Z) covariance (diag(std)⁻² + precision)⁻¹, with std (M, Z).

    Negative eigenvalues of the scaled precision, which differences can have, count as 0.
    """
    symmetric = 0.5 * (precision + precision.transpose(0, 2, 1))
    scaled = std[:, :, None] * symmetric * std[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    vectors = std[:, :, None] * vectors
    return np.einsum("mij,mj,mkj->mik", vectors, 1.0 / (1.0 + np.maximum(values, 0.0)), vectors)


def _precision(search: Search, z: np.ndarray, temperature: float) -> np.ndarray:
    """(M, Z, Z) precision of the likelihood at z (M, Z)."""
    return search.curvatures(z, WIDE) * search.problem.observations / temperature
