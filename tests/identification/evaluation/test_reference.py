"""The false-alarm rate of the loss test is the stated one for logs of any length."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.identification.evaluation.reference import (
    LEVELS,
    SPEEDS,
    has_reference_metrics,
    loss_metrics,
    loss_p_value,
    num_blocks,
    reference_metrics,
    sample_residuals,
)
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.latents.standardise import standard_posterior
from motorprior.identification.physics.initial_motor import with_motor
from motorprior.identification.physics.motor_fit import fit_motors
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import identification_preset
from motorprior.identification.residual import without_residual
from motorprior.identification.training_data.windows import training_data

FLEET, NEW = load_fleet("mixed"), 32
RECIPE = replace(identification_preset("rollout"), num_neurons=0)


METRICS = {
    "loss_mean": 0.16, "loss_log_mean": -2.0, "loss_log_std": 0.4, "loss_motors": 24.0, "loss_pieces": 18.0,
    "loss_piece_variance": 2.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def p_values():
    """{seconds: (NEW,) p-values of held-out motors}, adapted to a log of this length."""
    rng = np.random.default_rng(5)
    log = record(FLEET.sample(24, rng), PRESETS["rollout"], 5000, 0, FLEET)
    data = training_data(log, RECIPE, "log")
    bare = without_residual(data.scales, RECIPE)
    fit = fit_motors(bare, WindowRuns(data, RECIPE), (), True, 0)
    recipe = replace(RECIPE, num_latents=len(fit.center))
    network, mean, _ = standard_posterior(with_motor(bare, fit.center, fit.terms), data, recipe, fit.offsets)
    metrics = reference_metrics(network, data, recipe, mean, log)
    new, found = FLEET.sample(NEW, rng), {}
    for seconds in (2, 5, 10, 30):
        log = record(new, PRESETS["adapt"], round(seconds / recipe.period), 70 + seconds, FLEET)
        data = training_data(log, recipe, "log")
        posterior = fit_posterior(network, data, recipe, metrics["loss_mean"])
        found[seconds] = loss_p_value(metrics, posterior.loss, num_blocks(posterior.windows, recipe))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [2, 5, 10, 30])
def test_new_motors_of_the_fleet_are_rarely_outliers_for_any_length_of_the_log(p_values, seconds):
    own = p_values[seconds]
    for level in (0.01, 0.05, 0.1):  # three standard errors of NEW motors
        assert np.mean(own < level) <= level + 3 * np.sqrt(level * (1 - level) / NEW), level
    assert 0.2 < np.median(own) < 0.8


def losses_of(rng: np.random.Generator, motors: int, seconds: int) -> np.ndarray:
    """(motors, windows): a spread of 0.5 between motors' logarithms, pieces with a variance of 2 over mean squared."""
    length = round(1 / num_blocks(1, RECIPE))
    level = np.exp(-2.0 + 0.5 * rng.standard_normal((motors, 1)))
    of_pieces = np.exp(rng.normal(-0.5 * np.log(3.0), np.sqrt(np.log(3.0)), (motors, seconds)))
    return np.repeat(level * of_pieces, length, axis=1)


def test_false_alarms_are_as_frequent_as_stated_on_logs_of_any_length():
    rng, counts = np.random.default_rng(1), (2, 5, 10, 20, 30)
    alarms = {(count, level): [] for count in counts for level in (0.01, 0.05)}
    as_if_long = []
    for _ in range(100):  # priors, each trained on motors of its own
        metrics = loss_metrics(losses_of(rng, 32, 20), RECIPE, "")
        assert metrics["loss_pieces"] == 20.0
        for count in counts:
            losses = losses_of(rng, 300, count).mean(axis=1)
            found = loss_p_value(metrics, losses, float(count))
            for level in (0.01, 0.05):
                alarms[count, level].append(np.mean(found < level))
            if count == 2:
                as_if_long.append(np.mean(loss_p_value(metrics, losses, 20.0) < 0.01))
    for (count, level), shares in alarms.items():
        assert 0.3 * level < np.mean(shares) < 2.0 * level, (count, level, np.mean(shares))
    assert np.mean(as_if_long) > 0.025


def test_metrics_of_a_prior_are_complete_or_not():
    residuals = {f"residual_p{level:02d}_{pool}": 1e-3 * level for level in LEVELS for pool in SPEEDS}
    assert has_reference_metrics(METRICS, closed_loop=False) and not has_reference_metrics(METRICS, closed_loop=True)
    assert has_reference_metrics(METRICS | residuals, closed_loop=True)
    for name in METRICS | residuals:
        others = {key: value for key, value in (METRICS | residuals).items() if key != name}
        assert not has_reference_metrics(others, closed_loop=True), name
    assert np.isfinite(sample_residuals(residuals, np.random.default_rng(0), np.linspace(-9, 9, 99))).all()
