"""The posterior of z for new motors: recovered truth on motors whose z is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS, record, trial
from motorprior.identification.judging.reference import draw_residuals, ending, loss_p_value, reference_metrics
from motorprior.identification.latents.latent_fit import adapt, tiled_windows, window_losses
from motorprior.identification.presets import identification_preset
from motorprior.identification.train import Identified, identify
from motorprior.identification.training_data.windows import MEANS, TrainingData, training_data
from motorprior.logs.motor_log import MotorLog

BENCH = PRESETS["rollout"]
RECIPE = replace(
    identification_preset("rollout"),
    own_latents=False, num_latents=2, num_neurons=16, warm_up=60, steps=500, batch=128, window=32, physics_first="",
    learning_rate=1e-2, kl_weight=1e-4,
)  # fmt: skip


@pytest.fixture(scope="module")
def fleet_log() -> MotorLog:
    fleet = load_fleet("mixed")
    return record(fleet.sample(12, np.random.default_rng(3)), BENCH, 4000, 3, fleet)


@pytest.fixture(scope="module")
def prior(fleet_log: MotorLog) -> Identified:
    return identify(training_data(fleet_log, RECIPE, "log"), RECIPE, 0)


def log_of(motors: LatentActuator, segments: int) -> TrainingData:
    """A bench log of learned motors: what the prior itself says such motors do."""
    parts = []
    for segment in range(segments):
        case = trial(np.random.default_rng([9, segment, 1]), "impacts", 500, motors.num_motors, BENCH, hold=True)
        parts.append((case, run(motors, case)))
    count = 500 * segments
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(response, name) for _, response in parts])
        for name in ("joint_pos", "joint_vel", "joint_torque")
    }
    log = MotorLog(
        time=np.arange(count) * BENCH.period,
        position_target=np.concatenate([case.position_target for case, _ in parts]),
        external_torque=np.concatenate([case.external_torque for case, _ in parts]),
        load_inertia=np.concatenate([np.tile(case.load_inertia, (500, 1)) for case, _ in parts]),
        segment=np.repeat(np.arange(segments), 500),
        joint_names=tuple(f"m{index}" for index in range(motors.num_motors)),
        robot="bench",
        motor="learned",
        source="test",
        **joined,
    )
    data = training_data(log, RECIPE, "log")
    # learned motors step as the rollout does: their velocities and torques are those of half a step before already
    series = data.series.copy()
    series[..., MEANS] = training_data(log, replace(RECIPE, objective="torque"), "log").series[..., MEANS]
    return replace(data, series=series)


@pytest.mark.slow
def test_the_latents_of_motors_drawn_from_the_prior_are_recovered(prior: Identified):
    truth = np.random.default_rng(8).standard_normal((4, 2))  # not the seed of the descent's starts
    data = log_of(LatentActuator(prior.network, truth), 4)
    found = adapt(prior.network, data, RECIPE, temperature=0.01)
    # Their logs have no error but rounding, and what a window does not know of the play at its start.
    assert np.abs(found.mean - truth).max() < 0.25
    assert np.sqrt(np.mean((found.mean - truth) ** 2)) < 0.1


@pytest.mark.slow
def test_more_log_leaves_less_doubt_and_no_log_window_would_leave_the_prior(prior: Identified):
    motors = LatentActuator(prior.network, np.random.default_rng(1).standard_normal((3, 2)))
    short, long = (adapt(prior.network, log_of(motors, count), RECIPE, temperature=1.0) for count in (1, 4))
    volume = [np.linalg.det(one.covariance) for one in (short, long)]
    # of the fleet; a single motor's curvature is that of where its fit ended, sticking or slipping
    assert np.mean(np.log(volume[1] / volume[0])) < -np.log(4.0) and np.all(volume[1] < 1.5 * volume[0])
    assert np.all(volume[0] < 1.0)
    hot = adapt(prior.network, log_of(motors, 1), RECIPE, temperature=1e9)
    np.testing.assert_allclose(hot.covariance, np.tile(np.eye(2), (3, 1, 1)), atol=1e-3)
    np.testing.assert_allclose(hot.mean, 0.0, atol=0.05)


def test_windows_do_not_overlap_and_never_cross_a_segment(fleet_log: MotorLog):
    data = training_data(fleet_log, RECIPE, "log")
    windows = tiled_windows(data, RECIPE)
    length = RECIPE.history + RECIPE.window
    # 4 segments of 1000 rows: the first window ends at row 92, then one every 32 rows: 1 + (1000 - 92) // 32 = 29.
    assert windows.shape == (12, 4 * 29, length, data.series.shape[-1])
    np.testing.assert_array_equal(windows[2, 30], data.series[2, 1000 + 32 : 1000 + 32 + length])


def test_motors_of_the_fleet_are_no_surprise_and_other_machines_are(prior: Identified, fleet_log: MotorLog):
    data = training_data(fleet_log, RECIPE, "log")
    metrics = reference_metrics(prior.network, data, RECIPE, prior.mean, fleet_log)
    own = window_losses(prior.network, data, RECIPE, prior.mean).mean(axis=1)
    whole = metrics["loss_pieces"]
    chances = loss_p_value(metrics, own, whole)
    assert np.mean(chances < 0.01) < 0.1 and 0.2 < np.median(chances) < 0.8
    assert np.all(loss_p_value(metrics, 20 * np.maximum(own, np.median(own)), whole) < 0.01)


def test_residuals_have_the_percentiles_of_their_speed_they_were_recorded_with(prior: Identified, fleet_log: MotorLog):
    data = training_data(fleet_log, RECIPE, "log")
    metrics = reference_metrics(prior.network, data, RECIPE, prior.mean, fleet_log)
    spreads = []
    for pool, speed in (("slow", 0.1), ("medium", -1.0), ("fast", -9.0)):
        drawn = draw_residuals(metrics, np.random.default_rng(0), np.full((200, 1000), speed))
        for level in (5, 25, 50, 75, 95):
            wanted = metrics[f"residual_p{level:02d}_{pool}"]
            assert np.percentile(drawn, level) == pytest.approx(wanted, abs=2e-4 + 0.02 * drawn.std())
        spreads.append(drawn.std())
    assert spreads[0] < spreads[2]  # a model errs more where a motor moves
    mixed = draw_residuals(metrics, np.random.default_rng(0), np.tile([0.1, -9.0], (100_000, 1)))
    assert mixed[:, 0].std() == pytest.approx(spreads[0], rel=0.05)
    assert mixed[:, 1].std() == pytest.approx(spreads[2], rel=0.05)


def test_a_log_without_torques_is_judged_by_a_loss_without_torques(prior: Identified, fleet_log: MotorLog):
    data = training_data(fleet_log, RECIPE, "log")
    metrics = reference_metrics(prior.network, data, RECIPE, prior.mean, fleet_log)
    blind = training_data(replace(fleet_log, joint_torque=None), RECIPE, "log")
    blind = replace(blind, scales=data.scales)
    losses = window_losses(prior.network, blind, RECIPE, prior.mean).mean(axis=1)
    assert metrics["loss_mean_without_torque"] == pytest.approx(losses.mean(), rel=1e-5)
    assert metrics["loss_mean_without_torque"] < metrics["loss_mean"]  # torques are one more thing to err in
    assert 0.2 < np.median(loss_p_value(metrics, losses, metrics["loss_pieces"], ending(False))) < 0.8
    alone = reference_metrics(prior.network, blind, RECIPE, prior.mean, replace(fleet_log, joint_torque=None))
    assert alone["loss_mean"] == pytest.approx(losses.mean(), rel=1e-5) and "loss_mean_without_torque" not in alone
