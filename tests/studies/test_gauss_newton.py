"""Gauss-Newton with a Gaussian prior: the closed form for linear residuals, and convergence with stiction."""

import numpy as np
import pytest

from motorprior.studies.gauss_newton import GaussianPrior, search

SLOPE = np.array([[2.0, 0.5], [0.0, 1.0], [1.0, -1.0]])
OFFSET = np.array([1.0, -2.0, 0.5])


def test_linear_residuals_give_the_closed_form_and_its_covariance():
    prior = GaussianPrior(np.array([0.3, -0.2]), np.array([0.5, 2.0]), np.array([0.1, 0.1]))
    found = search(lambda x: SLOPE @ x + OFFSET, np.array([5.0, -5.0]), prior, 5)
    weight = np.diag(prior.deviation**-2)
    exact = np.linalg.solve(SLOPE.T @ SLOPE + weight, weight @ prior.mean - SLOPE.T @ OFFSET)
    assert found.x == pytest.approx(exact, abs=1e-9)
    assert found.covariance(prior) == pytest.approx(np.linalg.inv(SLOPE.T @ SLOPE + weight))


def test_a_constant_without_effect_keeps_its_prior():
    prior = GaussianPrior(np.array([0.0, 0.7]), np.array([1.0, 0.3]), np.array([0.2, 0.2]))
    found = search(lambda x: np.array([10.0 * (x[0] - 2.0)]), np.array([0.0, 1.5]), prior, 5)
    assert found.x == pytest.approx([2.0 * 100.0 / 101.0, 0.7])
    assert np.sqrt(found.covariance(prior)[1, 1]) == pytest.approx(0.3)


def test_wide_differences_converge_with_stiction_and_narrow_ones_do_not():
    def sticking(x: np.ndarray) -> np.ndarray:
        return np.array([20.0, 10.0]) * (np.round(x[0], 1) - 1.0)  # moves in steps of 0.1, flat between them

    def found(step: float) -> float:
        prior = GaussianPrior(np.zeros(1), np.ones(1), np.array([step]))
        return float(search(sticking, np.array([0.02]), prior, 10).x[0])

    assert found(0.3) == pytest.approx(1.0, abs=0.06)
    assert abs(found(0.001)) < 0.1
