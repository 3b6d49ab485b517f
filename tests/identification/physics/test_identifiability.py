"""Constants that move the joint of a log are identifiable, others are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics.motor_problem import (
    INITIAL_MOTOR,
    TORQUES,
    encoded,
    grey_box,
    identifiable_constants,
    unidentifiable_limits,
    unknown_torque_scale,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import POS, VEL, TrainingData
from motorprior.logs.motor_log import PHYSICAL_GAINS

PRESET = replace(PRESETS["per_motor"], warm_up=60)
CENTRAL = np.zeros((1, len(PARAMETERS)))
"""Latents of the central motor."""


@pytest.fixture(scope="module")
def wide_box() -> GreyBox:
    """Motors with a torque limit that they do not reach, and without backlash."""
    constants = INITIAL_MOTOR | {"torque_limit": 100.0, "backlash": 1e-7}
    return grey_box(encoded(constants, ()), (), PRESET)


@pytest.fixture(scope="module")
def noisy_data(wide_box: GreyBox, decoder_data: Callable[..., TrainingData]) -> TrainingData:
    """Log of the central motor with noise of 0.3 mrad and 0.02 rad/s."""
    data = decoder_data(wide_box, CENTRAL, segments=5, rows=400)
    series = data.series.copy()
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((*series.shape[:2], 2)) * [3e-4, 0.02]
    series[..., [POS, VEL]] += noise.astype(np.float32)
    return replace(data, series=series)


def test_constants_that_move_the_joint_are_identifiable(
    wide_box: GreyBox, noisy_data: TrainingData
):
    runs = WindowRuns(noisy_data, PRESET)

    identifiable = identifiable_constants(wide_box, runs, CENTRAL, PARAMETERS[:-1])

    assert {"kp", "kd_over_kp", "delay", "armature", "coulomb"} <= identifiable
    assert not {"torque_limit", "backlash"} & identifiable


def test_a_torque_limit_that_is_not_reached_is_unidentifiable(
    wide_box: GreyBox, noisy_data: TrainingData
):
    limits = unidentifiable_limits(wide_box, WindowRuns(noisy_data, PRESET), CENTRAL)

    assert list(limits) == ["torque_limit"]
    assert limits["torque_limit"].tolist() == [True]


def test_a_recipe_without_a_limit_does_not_report_it(wide_box: GreyBox, noisy_data: TrainingData):
    runs = WindowRuns(noisy_data, replace(PRESET, lacks=("torque_limit",)))

    assert unidentifiable_limits(wide_box, runs, CENTRAL) == {}


def scaled_box(size: float) -> GreyBox:
    """Motors with the torques of the initial motor times ``size``."""
    scaled = {name: size * INITIAL_MOTOR[name] for name in TORQUES if name in INITIAL_MOTOR}
    return grey_box(encoded(INITIAL_MOTOR | scaled, ()), (), PRESET)


def without_torque(data: TrainingData, noise: float) -> TrainingData:
    """Data without joint torques, and with noise of the angles [rad]."""
    series = data.series.copy()
    errors = noise * np.random.default_rng(0).standard_normal(series.shape[:2])
    series[..., POS] += errors.astype(np.float32)
    return replace(data, series=series, has_torque=False)


@pytest.mark.parametrize(("size", "noise", "hidden"), [(1.0, 0.02, False), (10.0, 0.02, True)])
def test_the_scale_of_torques_is_unknown_where_noise_hides_the_effect_of_the_load(
    decoder_data: Callable[..., TrainingData], size: float, noise: float, hidden: bool
):
    box = scaled_box(size)
    data = without_torque(decoder_data(box, CENTRAL, segments=5, rows=400), noise)

    unknown = unknown_torque_scale(box, WindowRuns(data, PRESET), CENTRAL)

    assert unknown.tolist() == [hidden]


def test_logged_gains_set_the_scale_of_torques_that_noise_hides(
    decoder_data: Callable[..., TrainingData],
):
    box = scaled_box(10.0)
    data = without_torque(decoder_data(box, CENTRAL, segments=5, rows=400), 0.02)
    runs = WindowRuns(data, replace(PRESET, gain_unit=PHYSICAL_GAINS))

    unknown = unknown_torque_scale(replace(box, gain_unit=PHYSICAL_GAINS), runs, CENTRAL)

    assert not unknown.any()


def test_the_scale_of_torques_is_unknown_if_gains_differ_within_a_class(
    decoder_data: Callable[..., TrainingData],
):
    box = scaled_box(1.0)
    # kp of the motors differs by a factor of exp(2) = 7
    z = np.concatenate([CENTRAL, CENTRAL + 2.0 * np.isin(PARAMETERS, "kp")])
    runs = WindowRuns(decoder_data(box, z, segments=5, rows=400), PRESET)

    assert unknown_torque_scale(box, runs, z + 0.01).all()
