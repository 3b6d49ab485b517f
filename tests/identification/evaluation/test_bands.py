"""Bands of samples have their nominal coverage."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.fit_metrics import RESIDUAL_LEVELS, SPEED_POOLS, FitMetrics
from motorprior.actuator.grey_box import GreyBox
from motorprior.evaluation.bands import log_coverage
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

PRESET = replace(PRESETS["rollout"], warm_up=60, window=100)


MOTORS = 24
STD = 0.5
"""Standard deviation of the latents of the motors with a posterior."""


@pytest.fixture(scope="module")
def box(grey_box: Callable[..., GreyBox]) -> GreyBox:
    return grey_box(spread=0.3)


@pytest.fixture(scope="module")
def prior(box: GreyBox) -> Any:
    """A prior whose model has next to no residual."""
    percentiles = tuple(1e-9 * level for level in RESIDUAL_LEVELS)
    metrics = FitMetrics(residual_percentiles=(percentiles,) * len(SPEED_POOLS))
    return SimpleNamespace(model=box, metrics=metrics)


def runs_with(z: np.ndarray, box: GreyBox, decoder_data: Callable[..., TrainingData]) -> WindowRuns:
    return WindowRuns(decoder_data(box, z, segments=3), PRESET)


def posterior_with(std: float, runs: WindowRuns) -> LatentPosterior:
    """Posterior with mean 0 and this standard deviation of every latent."""
    covariance = np.broadcast_to(std**2 * np.eye(3), (MOTORS, 3, 3))
    return LatentPosterior(np.zeros((MOTORS, 3)), covariance, np.zeros(MOTORS), runs.windows)


def test_bands_of_a_posterior_have_their_nominal_coverage(prior, box, decoder_data):
    z = STD * np.random.default_rng(4).standard_normal((MOTORS, 3))
    runs = runs_with(z, box, decoder_data)

    coverage = log_coverage(prior, posterior_with(STD, runs), [runs])

    assert 0.35 < coverage[50] < 0.65
    assert 0.8 < coverage[90] <= 0.97


def test_bands_of_a_prior_have_their_nominal_coverage(prior, box, decoder_data):
    z = np.random.default_rng(5).standard_normal((MOTORS, 3))
    runs = runs_with(z, box, decoder_data)

    coverage = log_coverage(prior, posterior_with(1.0, runs), [runs])

    assert 0.35 < coverage[50] < 0.65
    assert 0.8 < coverage[90] <= 0.97


def test_bands_of_an_overconfident_posterior_are_too_narrow(prior, box, decoder_data):
    z = STD * np.random.default_rng(4).standard_normal((MOTORS, 3))
    runs = runs_with(z, box, decoder_data)

    coverage = log_coverage(prior, posterior_with(0.01 * STD, runs), [runs])

    assert coverage[90] < 0.3
