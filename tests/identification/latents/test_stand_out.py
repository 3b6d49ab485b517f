"""A motor that is unlike the others is named, with what is odd; one of the same population hardly ever is."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from motorprior.identification.latents.stand_out import FEWEST, stand_out

LATENTS = 3


def prior_of(latents: np.ndarray, log_var: float = -4.0) -> Any:
    """A prior whose latents are its constants'."""
    network = SimpleNamespace(num_latents=LATENTS, motor=None, decoder_latents=lambda z: z)
    return SimpleNamespace(network=network, mean=latents, log_var=np.full(latents.shape, log_var))


def test_a_motor_that_is_far_out_is_named_with_its_constant():
    latents = np.random.default_rng(0).standard_normal((12, LATENTS))
    latents[7, 2] = -9.0
    found = leave_one_out_outliers(prior_of(latents))
    assert found is not None
    assert found.p_value.argmin() == 7 and found.p_value[7] < 1e-3 and found.deviation[7] < -4.0
    assert found.latent[7] == "latent 2"


def test_the_p_value_of_one_more_motor_is_one():
    rng = np.random.default_rng(1)
    found = [leave_one_out_outliers(prior_of(rng.standard_normal((12, LATENTS)), -20.0)) for _ in range(400)]
    p_values = np.array([each.p_value[0] for each in found if each is not None])
    assert np.mean(p_values < 0.2) == pytest.approx(0.2, abs=0.06)


def test_a_constant_that_the_log_does_not_know_is_not_odd():
    latents = np.random.default_rng(2).standard_normal((12, LATENTS))
    latents[3, 0] = 5.0
    sure, unsure = (leave_one_out_outliers(prior_of(latents, log_var)) for log_var in (-20.0, 2.0))
    assert sure is not None and unsure is not None
    assert sure.p_value[3] < 0.1 * unsure.p_value[3]


def test_a_few_motors_are_no_population():
    assert leave_one_out_outliers(prior_of(np.zeros((FEWEST - 1, LATENTS)))) is None
