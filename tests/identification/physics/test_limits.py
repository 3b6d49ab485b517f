"""Limits are decided by the windows in which they bind."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS, parameters_of
from motorprior.identification.physics.limits import LimitedMotors, with_decided_limits
from motorprior.identification.physics.motor_fit import fit_motors
from motorprior.identification.physics.motor_model_fit import ModelLevel, model_level
from motorprior.identification.physics.motor_problem import (
    centred_search,
    fixed_constants,
    grey_box,
    initial_center,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS, Recipe
from motorprior.identification.windows import POS, READING, TARGET, TORQUE, VEL, TrainingData
from motorprior.robots.motor_models import MotorModel, StatedValue

Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60)
LIMIT = PARAMETERS.index("torque_limit")
KP = PARAMETERS.index("kp")
KD_OVER_KP = PARAMETERS.index("kd_over_kp")


def noisy_logs(
    decoder_data: Data, limits: list[float], segments: int = 20, recipe: Recipe = PRESET
) -> tuple[WindowRuns, np.ndarray]:
    """Free runs over noisy logs of motors with these limits, and the motors' outputs (M, K)."""
    center = initial_center(())
    z = 0.1 * np.random.default_rng(1).standard_normal((len(limits), len(center)))
    z[:, LIMIT] = np.log(limits) - center[LIMIT]
    data = decoder_data(grey_box(center, (), PRESET), z, segments=segments, rows=400)
    noise = np.random.default_rng(5).standard_normal((*data.series.shape[:2], 3))
    series = data.series.copy()
    series[..., [POS, VEL, TORQUE]] += (noise * [3e-4, 0.02, 0.02]).astype(np.float32)
    series[..., READING] = series[..., POS]
    return WindowRuns(replace(data, series=series), recipe), center + z


def saturated_share(runs: WindowRuns, outputs: np.ndarray) -> np.ndarray:
    """(M,) share of rows in which the control law requests more than the limit of a motor."""
    rows = np.concatenate([segment.rows for segment in runs.segments])
    kp, kd_over_kp, limit = np.exp(outputs[:, [KP, KD_OVER_KP, LIMIT]]).T
    error = rows[:, TARGET] - rows[:, POS]
    request = kp * (error - kd_over_kp * rows[:, VEL])
    return np.mean(np.abs(request) > limit, axis=0)


def test_a_limit_that_binds_in_few_rows_is_found(decoder_data: Data):
    runs, outputs = noisy_logs(decoder_data, [2.1])
    share = saturated_share(runs, outputs)
    assert np.all((share > 0.005) & (share < 0.04)), share

    fits = fit_motors(runs, (), together=False, seed=0, restarts=6)

    np.testing.assert_allclose(np.exp(fits.outputs[:, LIMIT]), 2.1, rtol=0.1)


def test_a_limit_that_a_search_missed_is_found_in_the_fit(decoder_data: Data):
    runs, outputs = noisy_logs(decoder_data, [1.5, 1.5])
    center = initial_center(())
    x = outputs - center
    x[:, LIMIT] = 4.0

    x = decided(runs, center, x, groups=np.arange(2))

    np.testing.assert_allclose(np.exp(center[LIMIT] + x[:, LIMIT]), 1.5, rtol=0.1)


def test_a_limit_that_binds_in_the_only_window_of_a_log_is_decided_without_a_test(
    decoder_data: Data,
):
    recipe = replace(PRESET, window=330)
    runs, outputs = noisy_logs(decoder_data, [0.3], 1, recipe)
    center = initial_center(())
    assert runs.windows == 1

    x = decided(runs, center, outputs - center, groups=np.zeros(1, int))

    assert np.isfinite(x).all()


def test_a_low_limit_that_all_siblings_exceed_is_off(decoder_data: Data):
    runs, outputs = noisy_logs(decoder_data, [1.0, 60.0, 60.0])
    center = initial_center(())

    x = decided(runs, center, outputs - center, groups=np.zeros(3, int))

    assert np.all(np.exp(center[LIMIT] + x[:, LIMIT]) > 10.0)


def test_a_limit_that_a_maker_states_stays_where_another_motor_has_none(decoder_data: Data):
    runs, outputs = noisy_logs(decoder_data, [60.0, 60.0])
    center = initial_center(())
    stated = MotorModel("A", torque_limit=StatedValue(8.0, 0.1))
    level = model_level((stated, MotorModel("B")), center, (), "", fixed_constants((), runs))
    assert level is not None

    x = outputs - center
    x[:, LIMIT] = np.log(8.0) - center[LIMIT]

    x = decided(runs, center, x, level.index, level=level)

    limits = np.exp(center[LIMIT] + x[:, LIMIT])
    np.testing.assert_allclose(limits[0], 8.0)
    assert limits[1] > 8.1


@pytest.mark.parametrize("limit", [1.5, 60.0])
def test_without_a_no_load_speed_the_torque_limit_replaces_the_stall_torque(
    decoder_data: Data, limit: float
):
    terms = ("torque_speed",)
    names = parameters_of(terms)
    runs, outputs = noisy_logs(decoder_data, [limit])
    center = np.append(initial_center(()), np.log([limit, 1e4]))
    x = np.append(outputs, center[len(PARAMETERS) :][None], axis=1) - center
    x[:, LIMIT] = 4.0

    x = decided(runs, center, x, np.zeros(1, int), terms)

    fitted = dict(zip(names, np.exp(center + x[0]), strict=True))
    assert fitted["stall_torque"] > 20.0
    if limit < 20.0:
        np.testing.assert_allclose(fitted["torque_limit"], limit, rtol=0.1)
    else:
        assert fitted["torque_limit"] > 20.0


def decided(
    runs: WindowRuns,
    center: np.ndarray,
    x: np.ndarray,
    groups: np.ndarray,
    terms: tuple[str, ...] = (),
    level: ModelLevel | None = None,
) -> np.ndarray:
    search = centred_search(center, terms, runs)
    fixed = fixed_constants(terms, runs)
    motors = LimitedMotors(search, center, terms, runs, fixed, groups, level)
    return with_decided_limits(motors, x)
