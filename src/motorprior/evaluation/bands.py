"""Bands of posterior samples in free runs over a log, and their coverage of the recorded angles.

A sample of a band is a motor with z from the posterior, simulated in closed loop, plus a residual
of the prior (`sample_residuals`).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from motorprior.actuator.fit_metrics import RESIDUAL_LEVELS, FitMetrics
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.evaluation.training_errors import speed_pool
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import POSITION_SCALE, VELOCITY_SCALE, WindowRuns
from motorprior.identification.windows import VEL
from motorprior.logs.motor_log import MotorLog

NUM_SAMPLES = 40  # samples of the posterior
LEVELS = (50, 90)  # nominal coverage of the bands [%]
_STREAM = 53  # tag of the random stream


def zero_shot(prior: MotorPrior, log: MotorLog) -> LatentPosterior:
    """The distribution of the motors of a log, without the log: `MotorPrior.predicted`."""
    mean, std, misfit = prior.predicted(log)
    covariance = std[:, :, None] ** 2 * np.eye(mean.shape[1])
    return LatentPosterior(mean, covariance, np.zeros(len(mean)), 0, misfit)


def band(samples: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge (...,) of a central prediction interval of samples (D, ...).

    The interval covers ``level`` % of new samples. Weibull's plotting positions p·(D + 1) make this
    exact. The usual positions p·(D - 1) + 1 cover 86 %, not 90 %.
    """
    low, high = np.percentile(samples, [50 - level / 2, 50 + level / 2], axis=0, method="weibull")
    return low, high


def inside_bands(samples: np.ndarray, truth: np.ndarray | float) -> dict[int, np.ndarray]:
    """Level [%] -> (...,) whether the truth (...,) is inside the band of the samples (D, ...)."""
    inside = {}
    for level in LEVELS:
        low, high = band(samples, level)
        inside[level] = (low <= truth) & (high >= truth)
    return inside


def latent_samples(posterior: LatentPosterior, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """NUM_SAMPLES samples (M, Z) of the posteriors of M motors."""
    factors = np.linalg.cholesky(posterior.covariance)
    for _ in range(NUM_SAMPLES):
        noise = rng.standard_normal(posterior.mean.shape)
        yield posterior.mean + np.einsum("mij,mj->mi", factors, noise)


def sample_residual_scale(
    metrics: FitMetrics, misfit: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(M,) sampled factors on the residuals of motors on rows that they were not fitted to.

    ``misfit``, (M,) or (1,), are the factors on the rows of the fit.
    """
    log_scale = metrics.residual_growth_std * rng.standard_normal(len(misfit))
    return misfit * metrics.residual_growth * np.exp(log_scale)


def sample_residuals(
    metrics: FitMetrics, rng: np.random.Generator, joint_vel: np.ndarray
) -> np.ndarray:
    """Sample residuals [rad] for simulated velocities [rad/s] of any shape.

    They have the percentiles of the speed pool of their velocity. The quantile function is linear
    between percentiles, and extrapolated by one interval at both ends.
    """
    pool = speed_pool(joint_vel)
    quantile = rng.uniform(0, 100, joint_vel.shape)
    residuals = np.zeros(joint_vel.shape)
    for index, values in enumerate(metrics.residuals):
        low = 2 * values[0] - values[1]
        high = 2 * values[-1] - values[-2]

        in_pool = pool == index
        residuals[in_pool] = np.interp(
            quantile[in_pool], [0, *RESIDUAL_LEVELS, 100], [low, *values, high]
        )
    return residuals


def log_coverage(
    prior: MotorPrior, posterior: LatentPosterior, runs: Sequence[WindowRuns]
) -> dict[int, float]:
    """Level [%] -> share of the recorded angles inside the band of free runs."""
    rng = np.random.default_rng(_STREAM)
    inside = []
    for windows in runs:
        recorded_vel = windows.recorded(VEL)
        errors = []
        for z in latent_samples(posterior, rng):
            simulated = windows.errors(prior.model.motors(z))
            velocity = recorded_vel + VELOCITY_SCALE * simulated[:, :, 1]
            scale = sample_residual_scale(prior.metrics, posterior.misfit, rng)[:, None, None]
            residuals = scale * sample_residuals(prior.metrics, rng, velocity)
            errors.append(POSITION_SCALE * simulated[:, :, 0] + residuals)
        inside.append(inside_bands(np.stack(errors), 0.0))

    coverage = {}
    for level in LEVELS:
        angles = np.concatenate([of_runs[level].ravel() for of_runs in inside])
        coverage[level] = float(np.mean(angles))
    return coverage
