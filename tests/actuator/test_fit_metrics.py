"""Metrics of a fit are saved without loss; metrics that were not measured raise an error."""

import json

import pytest

from motorprior.actuator.fit_metrics import (
    RESIDUAL_LEVELS,
    SPEED_POOLS,
    FitMetrics,
    LossStatistics,
)
from motorprior.exceptions import ArtifactError

LOSSES = LossStatistics(0.1, -2.0, 0.3, 12, 2.5, 0.4)
ALL = FitMetrics(
    final_loss=0.1,
    minutes_of_log=3.5,
    aggregate_posterior_kl=0.01,
    losses=LOSSES,
    losses_without_torque=LOSSES,
    residual_percentiles=(tuple(1e-3 * level for level in RESIDUAL_LEVELS),) * len(SPEED_POOLS),
    replay_rmse=0.004,
    unexplained=0.2,
    residual_growth=1.2,
    residual_growth_std=0.3,
    saved_loss={"heat": -0.1},
    identified={"kp": True, "coulomb": False},
    unidentified_limits={"torque_limit": 20.0},
    unknown_torque_scales=2,
)


@pytest.mark.parametrize("metrics", [ALL, FitMetrics()], ids=["all", "none"])
def test_metrics_are_read_as_they_were_written(metrics: FitMetrics):
    table = json.loads(json.dumps(metrics.as_json()))
    assert FitMetrics.from_json(table, "a file") == metrics


def test_metrics_that_were_not_measured_are_an_error():
    with pytest.raises(ArtifactError):
        _ = FitMetrics().residuals

    with pytest.raises(ArtifactError):
        FitMetrics(losses=LOSSES).losses_for(has_torque=False)

    assert ALL.losses_for(has_torque=True) == LOSSES
