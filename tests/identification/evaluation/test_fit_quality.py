"""A prior says how well it replays its logs, and when the motors have physics that it lacks."""

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


def test_motors_that_made_the_log_leave_nothing(log: MotorLog):
    found = fit_quality(load_fleet("mixed").sample(MOTORS, 0).actuator(), log)
    assert np.median(found.motors) < 1e-9 and np.max(found.motors) < 2e-3  # dry friction amplifies rounding
    assert not found.misses_physics and found.widening == 1.0
    assert not any("warning" in line for line in found.lines())


def test_a_pd_in_place_of_the_motors_lacks_physics_and_says_so(log: MotorLog):
    found = fit_quality(nominal(MOTORS), log)
    assert found.unexplained > MISSING and found.misses_physics and found.widening > 1.0
    assert np.all(np.isfinite(found.motors)) and np.median(found.baseline) <= np.median(found.motors)
    assert "physics that the model lacks" in found.lines()[-1]


def test_the_worst_motor_and_segment_are_named():
    found = FitQuality(
        np.array([0.001, 0.004]), np.array([0.02, 0.02]), {"slow": 0.001, "fast": float("nan")},
        {0: 0.001, 3: 0.005, 7: 0.002}, 8, ("hip", "knee"),
    )  # fmt: skip
    text = "\n".join(found.lines())
    assert "knee with 4.0 mrad" in text and "fast" not in text
    assert "segment 3 with 5.0 mrad (of 3 of 8 segments that were replayed);" in text
    assert "were replayed" not in "\n".join(replace(found, num_segments=3).lines())


def test_motors_that_warm_are_replayed_as_warm_as_they_were(log: MotorLog, grey_network: Callable[..., LatentNetwork]):
    """A log that motors of a prior with heat made, cold at its beginning, is replayed by them without an error."""
    network = grey_network(spread=0.0, terms=("heat",), heat_loss=0.4, heat_time=10.0)
    motors, told = LatentActuator(network, np.zeros((MOTORS, network.num_latents))), []
    for part in log.segments():
        ((case, _),) = trials(part)
        work = float(np.median(part.time - log.time[0]))
        told.append(run(replace(motors, conditions=Conditions(network.warmth(motors.z, work))), case))
    made = replace(
        log,
        joint_pos=np.concatenate([each.encoder_pos if log.encoder == "rotor" else each.joint_pos for each in told]),
    )
    assert np.all(network.warmth(motors.z, log.duration) > 0.6)
    assert np.max(fit_quality(motors, made).motors) < 1e-6


def test_the_pd_follows_the_gains_that_segments_state(log: MotorLog):
    """A PD made the log at two gains; the one beside the motors is far closer to it if the log states them."""
    gains = np.where(np.arange(log.num_rows) < log.num_rows // 2, 1.0, 6.0)[:, None] * np.ones(MOTORS)
    told = replace(log, segment=(gains[:, 0] > 2.0).astype(int), stated_kp=3.0 * gains, stated_kd=0.1 * gains)
    made = [
        run(IdealPd.uniform(MOTORS, 3.0 * gain, 0.1 * gain, 5.0, 0.001, 0.008), case).joint_pos
        for gain, (case, _) in zip((1.0, 6.0), trials(told), strict=True)
    ]
    told = replace(told, joint_pos=np.concatenate(made), joint_vel=None)
    found = fit_quality(nominal(MOTORS), told)
    blind = fit_quality(nominal(MOTORS), replace(told, stated_kp=None, stated_kd=None))
    assert np.median(found.baseline) < 0.3 * np.median(blind.baseline)
    np.testing.assert_array_equal(found.motors, blind.motors)


def test_widened_draws_spread_wider_around_motors_that_stay_the_same(grey_network):
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
