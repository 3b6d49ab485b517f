"""Posteriors of the latents of a network without physics.

The latents that made a log are recovered, and a longer log leaves less variance.
"""

from dataclasses import replace

import numpy as np
import pytest
from series import complete

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.networks.objectives import initial_parameters, latent_network
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import POS, TARGET, TORQUE, VEL, TrainingData

RECIPE = replace(PRESETS["paper"], taps=(0, 1), num_neurons=8, num_latents=2)
SCALES = {"error_scale": 0.4, "velocity_scale": 0.4, "torque_scale": 0.5, "torque_limit": 50.0}
Z = np.array([[0.8, -0.5], [-0.4, 1.1]])


@pytest.fixture(scope="module")
def network() -> LatentNetwork:
    rng = np.random.default_rng(0)
    made = initial_parameters(rng, RECIPE)
    return latent_network(made | {"v1": 1.5 * made["v1"]}, RECIPE, SCALES)


def log_of(network: LatentNetwork, rows: int) -> TrainingData:
    """Log of random motion of motors with latents Z, with the torque of the network."""
    motion = np.random.default_rng(1).normal(0.0, 0.4, (len(Z), rows, 7))
    series = complete(motion.astype(np.float32))
    error = (series[..., TARGET] - series[..., POS]) / 0.4
    velocity = series[..., VEL] / 0.4

    for row in range(1, rows):
        past = [error[:, row], error[:, row - 1], velocity[:, row], velocity[:, row - 1]]
        series[:, row, TORQUE] = network.torque(np.stack(past, axis=1), Z)

    return TrainingData(series, np.arange(rows - 4), (slice(0, rows),), SCALES, True)


def test_the_latents_that_made_a_log_are_recovered(network: LatentNetwork):
    posterior = fit_posterior(network, log_of(network, 200), RECIPE, temperature=1e-3)
    np.testing.assert_allclose(posterior.mean, Z, atol=0.05)
    assert posterior.loss.max() < 1e-4


def test_a_longer_log_leaves_less_variance_and_an_uninformative_one_the_prior(
    network: LatentNetwork,
):
    def covariance(rows: int, temperature: float) -> np.ndarray:
        log = log_of(network, rows)
        return fit_posterior(network, log, RECIPE, temperature, start=Z).covariance

    short = covariance(rows=50, temperature=0.1)
    long = covariance(rows=400, temperature=0.1)
    hot = covariance(rows=50, temperature=1e9)

    assert np.all(np.linalg.det(long) < 0.3 * np.linalg.det(short))
    assert np.all(np.linalg.det(short) < 1.0)
    np.testing.assert_allclose(hot, np.tile(np.eye(2), (2, 1, 1)), atol=1e-4)
