"""A static joint keeps its prior; the misfit is the scale of a motor's residuals."""

from collections.abc import Callable

import numpy as np
from motor_logs import log_of

from motorprior.actuator.fit_metrics import (
    RESIDUAL_LEVELS,
    SPEED_POOLS,
    FitMetrics,
    LossStatistics,
)
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.evaluation.training_errors import residual_scale
from motorprior.identification.presets import PRESETS
from motorprior.logs.operations import moved
from motorprior.priors.adapt import adapt_to

PERCENTILES = tuple(1e-3 * (level - 50) / 45 for level in RESIDUAL_LEVELS)
METRICS = FitMetrics(
    losses=LossStatistics(
        mean=1.0, log_mean=0.0, log_std=0.1, motors=4, blocks=3.0, block_variance=0.1
    ),
    residual_percentiles=(PERCENTILES,) * len(SPEED_POOLS),
)


def test_a_static_joint_keeps_its_prior(grey_box: Callable[..., GreyBox]):
    time = 0.002 * np.arange(1500)
    is_moved = np.array([1.0, 0.0])
    target = 0.3 * np.sin(9.0 * time)[:, None] * is_moved
    log = log_of(
        time,
        target,
        np.roll(target, 5, axis=0),
        joint_names=("FL_calf", "FR_calf"),
        load_inertia=np.full_like(target, 0.01),
        external_torque=0.0 * target,
    )

    np.testing.assert_array_equal(moved(log), [True, False])

    z = np.random.default_rng(0).standard_normal((4, 3))
    provenance = {"recipe": PRESETS["pace"].as_json()}
    misfit = np.full(4, 0.5)
    prior = MotorPrior(grey_box(), z, 0.0 * z, "pace", "r", "m", provenance, METRICS, misfit=misfit)

    posterior = adapt_to(prior, log)

    mean, std, _ = prior.predicted(log)

    np.testing.assert_array_equal(posterior.mean[1], mean[1])
    np.testing.assert_array_equal(posterior.covariance[1], std[1] ** 2 * np.eye(3))
    assert posterior.misfit[1] == 0.5 != posterior.misfit[0]
    assert np.any(posterior.mean[0] != mean[0])


def test_misfit_is_the_scale_of_a_motors_residuals_relative_to_the_fleets():
    rng = np.random.default_rng(0)
    errors = rng.uniform(-1e-3, 1e-3, (20_000, 3)) * np.array([1.0, 3.0, 0.5])

    scale = residual_scale(METRICS.residuals, errors, np.zeros_like(errors))

    # the fleet's percentiles are linear: ±1 mrad at the levels 5 and 95, where uniform errors of
    # ±1 mrad reach 0.9 mrad
    np.testing.assert_allclose(scale, [0.9, 2.7, 0.45], rtol=0.03)
