"""Baselines beside a prior on real logs: their recipes suit the log, as the prior's own does."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS as BENCHES
from motorprior.bench.recording import record
from motorprior.identification.log_baselines import baseline_recipes
from motorprior.identification.presets import PRESETS
from motorprior.identification.training_data.windows import training_data
from motorprior.logs.motor_log import MotorLog


@pytest.fixture(scope="module")
def log() -> MotorLog:
    fleet = load_fleet("mixed")
    return record(fleet.sample(1, np.random.default_rng(0)), BENCHES["rollout"], 900, 1, fleet)


def in_segments(log: MotorLog, rows: int) -> MotorLog:
    return replace(log, segment=np.arange(log.num_rows) // rows, source="my.parquet")


@pytest.mark.parametrize("prior", ["quick", "long_runs"])
def test_baselines_of_long_runs_can_be_fitted_to_segments_shorter_than_their_windows(log: MotorLog, prior: str):
    short = in_segments(log, 450)
    recipes = baseline_recipes(short, PRESETS[prior])
    assert recipes.keys() == {"per_motor", "pooled_network", "coulomb_viscous", "stribeck"}
    for preset, recipe in recipes.values():
        assert recipe.history + recipe.window < 450
        assert replace(recipe, window=PRESETS[preset].window) == PRESETS[preset]
        assert len(training_data(short, recipe, "log").starts) > 0
