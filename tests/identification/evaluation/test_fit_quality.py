"""Replay errors of a prior, and its warning where the motors have dynamics that it lacks."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.optional_terms import Conditions
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.identification.baselines.replay_error import trials
from motorprior.identification.evaluation.fit_quality import MISSING, FitQuality, fit_quality
from motorprior.identification.latents.standardise import scaled, standardised
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import load_robot

MOTORS = 3


@pytest.fixture(scope="module")
def log() -> MotorLog:
    fleet = load_fleet("mixed")
    return record(fleet.sample(MOTORS, 0), bench_preset("rollout").for_robot(load_robot(fleet.robot)), 5000, 0, fleet)


def nominal(count: int) -> IdealPd:
    return IdealPd.uniform(count, 12.0, 1.1, 1.6)


def test_motors_that_made_the_log_have_no_error(log: MotorLog):
    found = fit_quality(load_fleet("mixed").sample(MOTORS, 0).actuator(), log)
    assert np.median(found.motors) < 1e-9 and np.max(found.motors) < 2e-3  # dry friction amplifies rounding
    assert not found.misses_physics and found.std_scale == 1.0
    assert not any("warning" in line for line in found.lines())


def test_a_pd_in_place_of_the_motors_is_warned_of(log: MotorLog):
    found = fit_quality(nominal(MOTORS), log)
    assert found.unexplained > MISSING and found.misses_physics and found.std_scale > 1.0
    assert np.all(np.isfinite(found.motors)) and np.median(found.baseline) <= np.median(found.motors)
    assert "the model lacks dynamics" in found.lines()[-1]


def test_the_worst_motor_is_named():
    found = FitQuality(np.array([0.001, 0.009, 0.001]), np.full(3, 0.02), ("hip", "knee", "foot"))
    first, warning = found.lines()
    assert "worst: knee with 9.0 mrad" in first and "left of knee 44 %" in warning


def test_motors_with_heat_are_replayed_at_the_temperature_of_each_segment(
    log: MotorLog, grey_network: Callable[..., LatentNetwork]
):
    network = grey_network(spread=0.0, terms=("heat",), heat_loss=0.4, heat_time=10.0)
    motors, responses = LatentActuator(network, np.zeros((MOTORS, network.num_latents))), []
    for part in log.segments():
        ((case, _),) = trials(part)
        work = float(np.median(part.time - log.time[0]))
        responses.append(run(replace(motors, conditions=Conditions(network.warmth(motors.z, work))), case))
    made = replace(
        log,
        joint_pos=np.concatenate(
            [each.encoder_pos if log.encoder == "rotor" else each.joint_pos for each in responses]
        ),
    )
    assert np.all(network.warmth(motors.z, log.duration) > 0.6)
    assert np.max(fit_quality(motors, made).motors) < 1e-6


def test_a_scaled_prior_has_the_same_motors_and_a_larger_standard_deviation(grey_network):
    rng = np.random.default_rng(0)
    network, mean = standardised(grey_network(latents=3), rng.standard_normal((40, 3)))
    wide, moved, log_var = scaled(network, mean, np.zeros_like(mean), 1.5)
    np.testing.assert_allclose(log_var, -2.0 * np.log(1.5))
    np.testing.assert_allclose(wide.decoder_latents(moved), network.decoder_latents(mean), atol=1e-9)
    draws = rng.standard_normal((2000, 3))
    spread = wide.decoder_latents(draws).std(axis=0) / network.decoder_latents(draws).std(axis=0)
    np.testing.assert_allclose(spread, 1.5, rtol=0.02)
    middle, wide_middle = (np.median(each.decoder_latents(draws), axis=0) for each in (network, wide))
    np.testing.assert_allclose(wide_middle, middle, atol=0.1)
