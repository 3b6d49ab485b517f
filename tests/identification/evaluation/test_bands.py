"""Bands of samples have their nominal coverage."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from motorprior.actuator.fit_metrics import RESIDUAL_LEVELS, SPEED_POOLS, FitMetrics
from motorprior.actuator.grey_box import GreyBox
from motorprior.evaluation.bands import log_coverage
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

PRESET = replace(PRESETS["rollout"], warm_up=60, window=100)


def test_bands_on_a_log_have_their_nominal_coverage(
    grey_box: Callable[..., GreyBox], decoder_data: Callable[..., TrainingData]
):
    box = grey_box(spread=0.3)
    rng = np.random.default_rng(4)
    covariance = np.broadcast_to(0.25 * np.eye(3), (24, 3, 3))
    true = 0.5 * rng.standard_normal((24, 3))
    runs = WindowRuns(decoder_data(box, true, segments=3), PRESET)
    percentiles = tuple(1e-9 * level for level in RESIDUAL_LEVELS)
    metrics = FitMetrics(residual_percentiles=(percentiles,) * len(SPEED_POOLS))
    prior: Any = SimpleNamespace(model=box, metrics=metrics)
    central = LatentPosterior(np.zeros((24, 3)), covariance, np.zeros(24), runs.windows)
    found = log_coverage(prior, central, [runs])
    assert 0.35 < found[50] < 0.65 and 0.8 < found[90] <= 0.97
    wide = WindowRuns(decoder_data(box, rng.standard_normal((24, 3)), segments=3), PRESET)
    unseen = replace(central, covariance=np.broadcast_to(np.eye(3), (24, 3, 3)))
    found_zero_shot = log_coverage(prior, unseen, [wide])
    assert 0.35 < found_zero_shot[50] < 0.65 and 0.8 < found_zero_shot[90] <= 0.97
    sure = log_coverage(prior, replace(central, covariance=1e-4 * covariance), [runs])
    assert sure[90] < 0.3
