"""The motors that made a log replay it, other models do not, and bands have their nominal coverage."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS as BENCHES
from motorprior.bench.recording import record
from motorprior.identification.evaluation.log_fidelity import (
    FREE_RUN,
    free_run_errors,
    free_runs,
    log_coverage,
    whole_runs,
    within_a_turn,
    zero_shot,
)
from motorprior.identification.evaluation.reference import LEVELS as PERCENTILES
from motorprior.identification.evaluation.reference import SPEEDS
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.training_data.windows import TrainingData
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.splits import train_test_halves

Z = np.array([[0.5, -1.0, 0.3], [0.0, 0.3, -0.8], [-1.2, 0.8, 0.1]])
PRESET = replace(PRESETS["rollout"], warm_up=60, window=100)


@pytest.fixture(scope="module")
def log() -> MotorLog:
    fleet = load_fleet("mixed")
    return record(fleet.sample(3, np.random.default_rng(0)), BENCHES["rollout"], 3000, 1, fleet)


def test_any_actuator_runs_freely_and_what_made_the_log_replays_it(
    grey_network: Callable[..., LatentNetwork], decoder_data: Callable[..., TrainingData]
):
    network = grey_network()
    runs = WindowRuns(decoder_data(network, Z), PRESET)
    truth, other = LatentActuator(network, Z), LatentActuator(network, Z[[1, 2, 0]])
    models: dict[str, Actuator] = {"truth": truth, "other": other}
    models["pd"] = IdealPd.uniform(3, 10.0, 0.5, 1.5)
    same = runs.residuals(network, Z, np.arange(3))
    np.testing.assert_array_equal(runs.errors(models["truth"]), same)
    errors = free_run_errors([runs], models)
    assert np.all(errors["truth"] < 1e-4)
    assert np.all(errors["other"] > 10 * errors["truth"]) and np.all(errors["pd"] > 10 * errors["truth"])


def test_halves_are_cut_between_segments_or_in_the_middle_of_one(log: MotorLog):
    train, test = train_test_halves(log)
    assert (train.num_rows, test.num_rows) in ((1000, 2000), (2000, 1000))
    whole = replace(log.rows(slice(0, 900)), segment=None)
    assert [half.num_rows for half in train_test_halves(whole)] == [450, 450]
    runs = free_runs(test, PRESET, "log")
    parts = test.segment_slices()
    assert runs.windows == sum((part.stop - part.start - 61) // round(FREE_RUN / 0.002) for part in parts) > 0


def test_bands_have_their_nominal_coverage(
    grey_network: Callable[..., LatentNetwork], decoder_data: Callable[..., TrainingData]
):
    network, rng = grey_network(spread=0.3), np.random.default_rng(4)
    covariance = np.broadcast_to(0.25 * np.eye(3), (24, 3, 3))
    true = 0.5 * rng.standard_normal((24, 3))
    runs = WindowRuns(decoder_data(network, true, segments=3), PRESET)
    speeds = {f"residual_p{level:02d}_{speed}": 1e-9 * level for level in PERCENTILES for speed in SPEEDS}
    prior: Any = SimpleNamespace(network=network, metrics=speeds)
    central = Posterior(np.zeros((24, 3)), covariance, np.zeros(24), runs.windows)
    found = log_coverage(prior, central, [runs])
    assert 0.35 < found[50] < 0.65 and 0.8 < found[90] <= 0.97
    wide = WindowRuns(decoder_data(network, rng.standard_normal((24, 3)), segments=3), PRESET)
    found_zero_shot = log_coverage(prior, zero_shot(prior, 24), [wide])
    assert 0.35 < found_zero_shot[50] < 0.65 and 0.8 < found_zero_shot[90] <= 0.97
    sure = log_coverage(prior, replace(central, covariance=1e-4 * covariance), [runs])
    assert sure[90] < 0.3


def test_a_whole_segment_is_one_free_run_and_its_errors_are_pooled(log: MotorLog):
    log = log.rows(slice(0, 1030))  # a segment of 1000 rows, and one that is shorter than the warm-up
    (run,) = whole_runs(log, PRESET, "log")
    assert run.windows == 1 and run.preset.window == 1000 - 1 - 60
    pd = IdealPd.uniform(3, 10.0, 0.5, 1.5)
    one, twice = (free_run_errors(runs, {"pd": pd})["pd"] for runs in ([run], [run, run]))
    np.testing.assert_allclose(one, twice, rtol=1e-6)
    assert np.all(one > 1e-3)


def test_a_simulation_that_broke_down_is_a_turn_off():
    errors = np.array([0.0, 0.3, 2.0 * np.pi, 7.0, 1e30, np.inf, np.nan])
    np.testing.assert_array_equal(within_a_turn(errors), [0.0, 0.3, *[2.0 * np.pi] * 5])
