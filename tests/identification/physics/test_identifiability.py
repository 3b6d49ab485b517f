"""Constants that move the joint in their own way are identified, others are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.estimates import Estimates, coordinate, value_at
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics.estimate_coordinates import Coordinates
from motorprior.identification.physics.estimate_profiles import MODEL_ERROR, with_fit
from motorprior.identification.physics.estimate_uncertainty import estimates_of
from motorprior.identification.physics.motor_problem import (
    INITIAL_MOTOR,
    TORQUES,
    encoded,
    grey_box,
    motor_search,
    unknown_torque_scale,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import Fit
from motorprior.identification.windows import POS, READING, VEL, TrainingData
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
    """Log of the central motor with noise of 0.03 mrad and 0.002 rad/s."""
    data = decoder_data(wide_box, CENTRAL, segments=5, rows=400)
    series = data.series.copy()
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((*series.shape[:2], 2)) * [3e-5, 0.002]
    series[..., [POS, VEL]] += noise.astype(np.float32)
    return replace(data, series=series)


def identified(box: GreyBox, data: TrainingData, z: np.ndarray = CENTRAL) -> set[str]:
    """Names of the constants that the log of the first motor identifies."""
    estimates = estimates_of(box, z, WindowRuns(data, PRESET))
    of_motors = estimates.identified(box.constants(z), box.terms)
    return {name for name, mask in of_motors.items() if mask[0]}


def test_constants_that_move_the_joint_are_identified(wide_box: GreyBox, noisy_data: TrainingData):
    names = identified(wide_box, noisy_data)

    assert {"kp", "delay", "load_friction"} <= names
    assert not {"torque_limit", "backlash", "velocity_filter"} & names


def test_intervals_hold_the_constants_that_made_the_log(
    wide_box: GreyBox, noisy_data: TrainingData
):
    values = wide_box.constants(CENTRAL)
    ends = estimates_of(wide_box, CENTRAL, WindowRuns(noisy_data, PRESET)).ends(values, ())

    for name in PARAMETERS:
        low, high = ends[name]
        assert low[0] <= values[name][0] <= high[0], name


def test_a_torque_limit_that_is_not_reached_is_at_least_the_largest_request(
    wide_box: GreyBox, noisy_data: TrainingData
):
    runs = WindowRuns(noisy_data, PRESET)
    values = wide_box.constants(CENTRAL)

    low, high = estimates_of(wide_box, CENTRAL, runs).ends(values, ())["torque_limit"]

    np.testing.assert_allclose(low, values["kp"] * runs.max_request)
    assert np.isinf(high).all()


def test_a_recipe_without_a_limit_does_not_report_it(wide_box: GreyBox, noisy_data: TrainingData):
    runs = WindowRuns(noisy_data, replace(PRESET, lacks=("torque_limit",)))

    assert "torque_limit" not in estimates_of(wide_box, CENTRAL, runs).fitted(())


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


def test_a_constant_is_not_identified_if_others_undo_its_change(
    decoder_data: Callable[..., TrainingData],
):
    # beside the torques of this motor those of the load vanish: only ratios move the joint
    box = scaled_box(30.0)
    data = without_torque(decoder_data(box, CENTRAL, segments=5, rows=400), noise=1e-3)
    runs = WindowRuns(data, PRESET)

    is_identified = estimates_of(box, CENTRAL, runs).identified(box.constants(CENTRAL), ())

    fitted = motor_search(box, runs).losses(CENTRAL)
    for name in ("kp", "armature"):
        alone = np.isin(PARAMETERS, name) * np.log(2.0)
        for change in (alone, -alone):
            assert motor_search(box, runs).losses(CENTRAL + change) > 1.1 * fitted
        assert not is_identified[name].any()


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


def test_errors_of_the_angle_hide_a_play(wide_box: GreyBox, noisy_data: TrainingData):
    def interval(error: float) -> np.ndarray:
        """(2,) interval of the play if angles have a slow error [rad]."""
        series = noisy_data.series.copy()
        rows = np.arange(series.shape[1])
        series[..., [POS, READING]] += (error * np.sin(0.01 * rows))[:, None].astype(np.float32)
        runs = WindowRuns(replace(noisy_data, series=series), PRESET)
        ends = estimates_of(wide_box, CENTRAL, runs).ends(wide_box.constants(CENTRAL), ())
        return ends["backlash"][:, 0]

    assert interval(0.0)[1] < 2e-3

    # the RMS error is 7 mrad
    assert interval(0.01)[1] > 2.0 * 7e-3


@pytest.mark.parametrize("share", [0.3, 1.0, 3.0])
def test_half_widths_hold_a_value_to_both_sides(
    wide_box: GreyBox, noisy_data: TrainingData, share: float
):
    runs = WindowRuns(noisy_data, PRESET)
    column = PARAMETERS.index("backlash")
    value = wide_box.constants(CENTRAL)["backlash"]
    size = share * value
    coordinates = Coordinates(wide_box, runs, CENTRAL, {"backlash": size})

    scale = coordinates.scale[:, column]
    y = coordinate("backlash", value, scale)
    width = coordinates.half_width(column, size)
    assert value_at("backlash", y - width, scale) <= np.maximum(value - size, 0.0) + 1e-12
    assert value_at("backlash", y + width, scale) >= value + size - 1e-12


@pytest.mark.parametrize(
    ("rise", "is_held"), [(0.5 * MODEL_ERROR, True), (2.0 * MODEL_ERROR, False)]
)
def test_intervals_hold_another_fit_only_if_its_loss_is_almost_the_same(
    wide_box: GreyBox, noisy_data: TrainingData, rise: float, is_held: bool
):
    coordinates = Coordinates(wide_box, WindowRuns(noisy_data, PRESET), CENTRAL, {})
    size = len(PARAMETERS)
    free = np.arange(size)
    estimates = Estimates(0.01**2 * np.eye(size)[None], coordinates.scale)
    kp = PARAMETERS.index("kp")
    x = CENTRAL + np.log(3.0) * (free == kp)
    loss = np.array([1.0 + rise])
    fit = Fit(x, loss, loss)

    wider = with_fit(estimates, coordinates, free, np.ones(1), fit, np.array([0]))

    values = wide_box.constants(CENTRAL)
    _, high = wider.ends(values, ())["kp"] / values["kp"]
    assert bool(high[0] >= 3.0 * (1.0 - 1e-6)) == is_held
    assert bool(wider.identified(values, ())["kp"][0]) != is_held
    # other constants did not change
    for name in ("armature", "delay"):
        np.testing.assert_allclose(
            wider.ends(values, ())[name], estimates.ends(values, ())[name], rtol=1e-6
        )
