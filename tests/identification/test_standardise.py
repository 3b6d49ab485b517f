"""New latents, the same motors: what they are together becomes N(0, I)."""

import numpy as np
import pytest

from motorprior.identification.standardise import MOTORS_PER_LATENT, standardised


def posteriors(motors: int, latents: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    mixing = np.diag([0.2, 1.0, 1.5])[:latents, :latents] + 0.3
    return 0.5 + rng.standard_normal((motors, latents)) @ mixing, rng.uniform(-6.0, -1.0, (motors, latents))


def test_the_aggregate_posterior_becomes_standard_normal(grey_network):
    mean, log_var = posteriors(24, 3)
    _, new_mean, new_log_var = standardised(grey_network(), mean, log_var)
    np.testing.assert_allclose(new_mean.mean(axis=0), 0.0, atol=1e-12)
    together = np.cov(new_mean.T, bias=True) + np.diag(np.exp(new_log_var).mean(axis=0))
    np.testing.assert_allclose(np.diag(together), 1.0)
    # What the diagonal of the posteriors cannot say is left out.
    assert np.abs(together - np.eye(3)).max() < 0.2


def test_every_motor_stays_what_it_is(grey_network):
    network = grey_network(network=0.3)
    mean, log_var = posteriors(24, 3)
    new_network, new_mean, _ = standardised(network, mean, log_var)
    assert network.motor is not None and new_network.motor is not None
    before, after = network.motor.decode(mean), new_network.motor.decode(new_mean)
    for name, values in before.items():
        np.testing.assert_allclose(after[name], values, rtol=1e-9, atol=1e-12)
    inputs = np.random.default_rng(1).standard_normal((24, 2 * len(network.taps)))
    np.testing.assert_allclose(new_network.torque(inputs, new_mean), network.torque(inputs, mean), atol=1e-12)
    np.testing.assert_allclose(new_network.armature(new_mean), network.armature(mean), rtol=1e-9)


@pytest.mark.parametrize("motors", [1, 3 * MOTORS_PER_LATENT - 1])
def test_too_few_motors_leave_the_latents_alone(grey_network, motors):
    network = grey_network()
    mean, log_var = posteriors(motors, 3)
    assert standardised(network, mean, log_var) == (network, mean, log_var)
