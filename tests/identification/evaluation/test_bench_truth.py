"""Errors of models that diverge on the bench."""

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.fleet import load_fleet
from motorprior.evaluation.bench_truth import bench_errors


def test_a_model_that_diverges_is_one_turn_off():
    motors, unstable = load_fleet("mixed").sample(12, np.random.default_rng(4)), IdealPd.uniform(12, -50.0, 0.0, 1e9)
    errors = bench_errors(motors, {"unstable": lambda index: unstable}, 0)["impacts"]
    assert np.all(errors["unstable"] == 2 * np.pi) and np.all(errors["physical"] < 0.1)
