"""Few motors are taken to differ as motors do; recorded ones take the place of what is assumed."""

import numpy as np
import pytest

from motorprior.identification.latents.standardise import WORTH, standardised, std_of_few


def test_one_motor_says_where_the_others_are_and_not_how_far():
    """Neither it nor another is the centre: the distance of the two has twice the variance of a motor."""
    np.testing.assert_allclose(
        std_of_few(np.array([[7.0, -2.0]]), np.array([0.1, 0.3])), [0.1 * 2**0.5, 0.3 * 2**0.5]
    )


@pytest.mark.parametrize("true", [0.02, 1.0])
def test_with_many_motors_the_assumption_is_forgotten(true: float):
    z = true * np.random.default_rng(0).standard_normal((4000, 1))
    np.testing.assert_allclose(std_of_few(z, np.array([0.1])), true, rtol=0.05)


def test_the_spread_is_that_of_the_posterior_predictive():
    """Of draws: a variance from the assumption, motors and a further one from it, those like the recorded ones kept."""
    rng, assumed, motors = np.random.default_rng(1), 0.3, 3
    variance = WORTH * assumed**2 / rng.chisquare(WORTH, 2_000_000)
    scatter = variance * rng.chisquare(motors - 1, len(variance))
    wanted = 0.2
    kept = variance[np.abs(scatter - wanted) < 0.02]
    new = np.sqrt(kept * (1 + 1 / motors)) * rng.standard_normal(len(kept))
    z = np.array([[0.0], [np.sqrt(wanted / 2)], [-np.sqrt(wanted / 2)]])
    degrees = WORTH + motors - 1  # of the t distribution, whose quartile stands for its scale
    quartile = {5: 0.7267}[int(degrees)]
    np.testing.assert_allclose(np.quantile(new, 0.75) / quartile, std_of_few(z, np.array([assumed]))[0], rtol=0.02)


def test_draws_after_one_motor_differ_from_it_and_it_stays_what_it_is(grey_network):
    mean, assumed = np.array([[0.1, -0.2, 0.3]]), np.array([0.1, 0.2, 0.0])
    network, new_mean = standardised(grey_network(), mean, assumed)
    np.testing.assert_allclose(network.decoder_latents(new_mean), mean, atol=1e-9)
    drawn = network.decoder_latents(np.random.default_rng(2).standard_normal((20_000, 3)))
    np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(2.0) * assumed, rtol=0.05, atol=1e-4)
