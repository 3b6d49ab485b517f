"""The Gaussian copula before a decoder: one formula for numpy and JAX, and its inverse."""

import numpy as np

from motorprior.actuator.copula import SCORES, Copula, scores

RNG = np.random.default_rng(0)
QUANTILES = np.sort(RNG.standard_normal((len(SCORES), 4)), axis=0)
MIXING = np.linalg.cholesky(0.5 * np.eye(4) + 0.5).T
Z = 1.5 * RNG.standard_normal((200, 4))


def test_latents_pass_through_their_quantiles_and_rise_beyond_them():
    copula = Copula(np.eye(4), QUANTILES)
    np.testing.assert_allclose(copula.decoder_latents(np.repeat(SCORES[:, None], 4, axis=1)), QUANTILES, atol=1e-12)
    x = np.linspace(-6.0, 6.0, 500)
    assert np.all(np.diff(copula.decoder_latents(np.repeat(x[:, None], 4, axis=1)), axis=0) > 0)


def test_scores_are_the_inverse():
    latents = Copula(MIXING, QUANTILES).decoder_latents(Z)
    np.testing.assert_allclose(scores(QUANTILES, latents), Z @ MIXING, atol=1e-9)
