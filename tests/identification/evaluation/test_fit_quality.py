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
from motorprior.identification.evaluation.fit_quality import fit_quality
from motorprior.identification.latents.standardise import standardised, with_scaled_spread
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
    motors, _ = fit_quality(load_fleet("mixed").sample(MOTORS, 0).actuator(), log)
    assert np.median(motors) < 1e-9 and np.max(motors) < 2e-3  # dry friction amplifies rounding


def test_a_tuned_pd_is_closer_to_the_motors_than_a_nominal_one(log: MotorLog):
    motors, baseline = fit_quality(nominal(MOTORS), log)
    assert np.all(np.isfinite(motors)) and np.median(baseline) <= np.median(motors)


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
    assert np.max(fit_quality(motors, made)[0]) < 1e-6


def test_the_pd_has_the_logged_gains_of_each_segment(log: MotorLog):
    gains = np.where(np.arange(log.num_rows) < log.num_rows // 2, 1.0, 6.0)[:, None] * np.ones(MOTORS)
    logged = replace(log, segment=(gains[:, 0] > 2.0).astype(int), stated_kp=3.0 * gains, stated_kd=0.1 * gains)
    made = [
        run(IdealPd.uniform(MOTORS, 3.0 * gain, 0.1 * gain, 5.0, 0.001, 0.008), case).joint_pos
        for gain, (case, _) in zip((1.0, 6.0), trials(logged), strict=True)
    ]
    logged = replace(logged, joint_pos=np.concatenate(made), joint_vel=None)
    motors, baseline = fit_quality(nominal(MOTORS), logged)
    same_motors, without_gains = fit_quality(nominal(MOTORS), replace(logged, stated_kp=None, stated_kd=None))
    assert np.median(baseline) < 0.3 * np.median(without_gains)
    np.testing.assert_array_equal(motors, same_motors)


def test_a_scaled_prior_has_the_same_motors_and_a_larger_standard_deviation(grey_network):
    rng = np.random.default_rng(0)
    network, mean = standardised(grey_network(latents=3), rng.standard_normal((40, 3)))
    wide, moved, log_var = with_scaled_spread(network, mean, np.zeros_like(mean), 1.5)
    np.testing.assert_allclose(log_var, -2.0 * np.log(1.5))
    np.testing.assert_allclose(wide.decoder_latents(moved), network.decoder_latents(mean), atol=1e-9)
    draws = rng.standard_normal((2000, 3))
    spread = wide.decoder_latents(draws).std(axis=0) / network.decoder_latents(draws).std(axis=0)
    np.testing.assert_allclose(spread, 1.5, rtol=0.02)
    middle, wide_middle = (np.median(each.decoder_latents(draws), axis=0) for each in (network, wide))
    np.testing.assert_allclose(wide_middle, middle, atol=0.1)
