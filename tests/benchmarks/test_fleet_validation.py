"""Priors against the motors of their bench and against held-out motors of its fleet."""

from pathlib import Path

import numpy as np
import pytest

from fleet_validation import validate_on_bench
from motorprior.artifacts import read_json
from motorprior.exceptions import ConfigError


@pytest.mark.slow
def test_errors_and_coverage_on_both_sets_of_motors(bench_prior: Path, tmp_path: Path):
    results = validate_on_bench([bench_prior], tmp_path, adapt_seconds=[1.0])
    figures = read_json(tmp_path / "figures.json")

    for quantity in ("bench_impact_rmse", "standing_rmse", "suspended_torque_hf"):
        for model in ("ideal_pd", "tuned_pd", "pace", "physical"):
            assert figures[f"{quantity}/{model}/train"] == figures[f"{quantity}/{model}"]
            assert np.isfinite(figures[f"{quantity}/{model}/held_out"])
    assert figures["suspended_rmse/physical"] < figures["suspended_rmse/tuned_pd"]

    assert 0.1 < figures["coverage50"] < figures["coverage90"]
    auc = results.where(quantity="two_sample_auc")
    areas = [auc.value(statistic=name) for name in ("low", "median", "high")]
    assert areas == sorted(areas) and areas[1] > 0.5
    assert 12 * figures["adapt_false_alarms/1"] < 6
    assert 0.5 < figures["adapt_rmse_ratio/1"] < 20.0


@pytest.mark.slow
def test_two_priors_of_a_preset_are_refused(bench_prior: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match="pace"):
        validate_on_bench([bench_prior, bench_prior], tmp_path / "twice")
    with pytest.raises(ConfigError):
        validate_on_bench([], tmp_path / "none")
