"""Static joints, and joints in contact, keep their prior; misfit is the scale of residuals."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from motor_logs import log_of

import motorprior as mp
from motorprior.actuator.fit_metrics import (
    RESIDUAL_LEVELS,
    SPEED_POOLS,
    FitMetrics,
    LossStatistics,
)
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import run, trial_of
from motorprior.evaluation.training_errors import residual_scale
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined, moved
from motorprior.priors.adapt import adapt_to
from motorprior.progress import Note, Progress

PERCENTILES = tuple(1e-3 * (level - 50) / 45 for level in RESIDUAL_LEVELS)
METRICS = FitMetrics(
    losses=LossStatistics(
        mean=1.0, log_mean=0.0, log_std=0.1, motors=4, blocks=3.0, block_variance=0.1
    ),
    residual_percentiles=(PERCENTILES,) * len(SPEED_POOLS),
)


def test_a_static_joint_keeps_its_prior(grey_box: Callable[..., GreyBox]):
    time = 0.002 * np.arange(1500)
    is_moved = np.array([1.0, 0.0])
    target = 0.3 * np.sin(9.0 * time)[:, None] * is_moved
    log = log_of(
        time,
        target,
        np.roll(target, 5, axis=0),
        joint_names=("FL_calf", "FR_calf"),
        load_inertia=np.full_like(target, 0.01),
        external_torque=0.0 * target,
    )

    np.testing.assert_array_equal(moved(log), [True, False])

    z = np.random.default_rng(0).standard_normal((4, 3))
    provenance = {"recipe": PRESETS["pace"].as_json()}
    misfit = np.full(4, 0.5)
    prior = MotorPrior(grey_box(), z, 0.0 * z, "pace", "r", "m", provenance, METRICS, misfit=misfit)

    posterior = adapt_to(prior, log)

    mean, std, _ = prior.predicted(log)

    np.testing.assert_array_equal(posterior.mean[1], mean[1])
    np.testing.assert_array_equal(posterior.covariance[1], std[1] ** 2 * np.eye(3))
    assert posterior.misfit[1] == 0.5 != posterior.misfit[0]
    assert np.any(posterior.mean[0] != mean[0])


@pytest.fixture
def prior(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    z = np.random.default_rng(0).standard_normal((4, 3))
    provenance = {"recipe": PRESETS["pace"].as_json()}
    assert METRICS.losses is not None
    losses = replace(METRICS.losses, mean=0.03, log_mean=np.log(0.03))
    metrics = replace(METRICS, losses=losses)
    return MotorPrior(grey_box(), z, 0.0 * z, "pace", "r", "m", provenance, metrics)


def log_of_motors(prior: MotorPrior, z: np.ndarray) -> MotorLog:
    """Sines of two joints with the latents z (2, 3)."""
    time = 0.002 * np.arange(3000)
    target = 0.3 * np.sin(np.array([9.0, 7.0]) * time[:, None])
    log = log_of(
        time,
        target,
        joint_names=("FL_calf", "FR_calf"),
        load_inertia=np.full_like(target, 0.01),
        external_torque=0.0 * target,
    )
    return replace(log, joint_pos=run(prior.model.motors(z), trial_of(log)).joint_pos)


def adapted(prior: MotorPrior, log: MotorLog) -> tuple[np.ndarray, list[str]]:
    """(2, 3) adapted latents, and the warnings."""
    notes: list[Note] = []
    mean = adapt_to(prior, log, Progress(notes.append)).mean
    return mean, [note.text for note in notes if note.severity == "warning"]


def log_in_contact(prior: MotorPrior, yielding: float = 0.0) -> MotorLog:
    """A log whose second joint touches a table, into which it moves by a share of the depth."""
    log = log_of_motors(prior, np.zeros((2, 3)))
    angle = log.joint_pos.copy()
    table = np.quantile(angle[:, 1], 0.7)
    depth = np.maximum(angle[:, 1] - table, 0.0)
    angle[:, 1] -= (1.0 - yielding) * depth
    return replace(log, joint_pos=angle)


@pytest.mark.parametrize("yielding", [0.0, 0.3], ids=["hard", "soft"])
def test_a_joint_in_contact_keeps_its_prior_and_is_named(prior: MotorPrior, yielding: float):
    log = log_in_contact(prior, yielding)

    mean, warnings = adapted(prior, log)

    np.testing.assert_array_equal(mean[1], prior.predicted(log).mean[1])
    assert np.any(mean[0] != prior.predicted(log).mean[0])
    assert len(warnings) == 1
    assert "FR_calf: for" in warnings[0]
    assert "contact" in warnings[0]
    assert "s after the start of its recording" in warnings[0]


def test_a_joint_in_contact_is_no_outlier(prior: MotorPrior):
    log = log_in_contact(prior)
    with pytest.warns(UserWarning, match="FR_calf: for .* the joint keeps the prior"):
        posterior = mp.adapt(prior, log)

    np.testing.assert_array_equal(posterior.mean[1], prior.predicted(log).mean[1])
    assert posterior.outlier_p_value[1] == 1.0


def test_joined_recordings_have_no_common_time_of_contact(prior: MotorPrior):
    log = log_in_contact(prior)

    _, warnings = adapted(prior, joined([log, log]))

    assert len(warnings) == 1
    assert re.search(r"FR_calf: for [\d.]+ s at ", warnings[0])


def test_a_joint_without_torque_is_not_in_contact(prior: MotorPrior):
    log = log_of_motors(prior, np.zeros((2, 3)))
    angle = log.joint_pos * np.array([1.0, 0.0])
    target = log.position_target + np.array([0.0, 0.6])

    _, warnings = adapted(prior, replace(log, joint_pos=angle, position_target=target))

    assert warnings == []


@pytest.mark.parametrize("seed", range(3))
def test_other_motors_of_the_fleet_are_adapted_without_an_alarm(prior: MotorPrior, seed: int):
    z = np.random.default_rng(seed).standard_normal((2, 3))

    mean, warnings = adapted(prior, log_of_motors(prior, z))

    assert warnings == []
    assert np.linalg.norm(mean - z) < 0.5 * np.linalg.norm(prior.mean.mean(axis=0) - z)


def test_misfit_is_the_scale_of_a_motors_residuals_relative_to_the_fleets():
    rng = np.random.default_rng(0)
    errors = rng.uniform(-1e-3, 1e-3, (20_000, 3)) * np.array([1.0, 3.0, 0.5])

    scale = residual_scale(METRICS.residuals, errors, np.zeros_like(errors))

    # the fleet's percentiles are linear: ±1 mrad at the levels 5 and 95, where uniform errors of
    # ±1 mrad reach 0.9 mrad
    np.testing.assert_allclose(scale, [0.9, 2.7, 0.45], rtol=0.03)
