"""Fits recover the constants of simulated motors.

The results are the same bytes on any number of threads.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics import window_runs
from motorprior.identification.physics.motor_fit import MotorFits, fit_motors
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.physics.population_fit import searched_near_others
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import GaussianPrior, Search
from motorprior.identification.windows import TrainingData

Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60)
MOTORS = 4
SPREAD = {
    "kp": 0.3,
    "kd_over_kp": 0.2,
    "delay": 0.4,
    "backlash": 0.4,
    "load_friction": 0.3,
    "armature": 0.3,
}
"""Standard deviations of the logarithms of the constants of true motors."""


def truth() -> np.ndarray:
    """(MOTORS, P) decoder outputs relative to the initial motor's."""
    rng = np.random.default_rng(2)
    raw = np.zeros((MOTORS, len(PARAMETERS)))
    for name, spread in SPREAD.items():
        raw[:, PARAMETERS.index(name)] = spread * rng.standard_normal(MOTORS) + 0.2

    return raw


def true_center() -> np.ndarray:
    """The initial motor, with a velocity filter of 3 ms, which is not its own."""
    center = initial_center(())
    center[PARAMETERS.index("velocity_filter")] = np.log(3e-3)
    return center


def true_box() -> GreyBox:
    return grey_box(true_center(), (), PRESET)


@pytest.fixture(scope="module")
def runs(decoder_data: Data) -> WindowRuns:
    return WindowRuns(decoder_data(true_box(), truth(), segments=10, rows=400), PRESET)


@pytest.fixture(scope="module")
def fits(runs: WindowRuns) -> MotorFits:
    return fit_motors(runs, (), True, 0)


def test_a_fit_recovers_the_constants_of_four_motors(fits: MotorFits):
    assert fits.loss.max() < 3e-3, fits.loss

    error = np.abs(fits.center + fits.offsets - true_center() - truth())
    bounds = {
        "kp": 0.03,
        "kd_over_kp": 0.05,
        "delay": 0.03,
        "backlash": 0.08,
        "load_friction": 0.1,
        "armature": 0.1,
    }

    for name, bound in bounds.items():
        errors_of_constant = error[:, PARAMETERS.index(name)]
        assert errors_of_constant.max() < bound, (name, errors_of_constant)


def test_a_fit_recovers_a_gain_far_from_the_initial_motor(decoder_data: Data):
    center = true_center()
    kp = PARAMETERS.index("kp")
    center[kp] += np.log(0.04)
    box = grey_box(center, (), PRESET)
    runs = WindowRuns(decoder_data(box, truth(), segments=5, rows=400), PRESET)

    fits = fit_motors(runs, (), True, 0)
    # kp is 25 times smaller than that of the initial motor; fits on other processors differ by 0.2
    expected = center[kp] + truth()[:, kp]

    np.testing.assert_allclose((fits.center + fits.offsets)[:, kp], expected, atol=0.25)


@pytest.mark.parametrize(("limit", "identifiable"), [(60.0, False), (1.5, True)])
def test_a_torque_limit_that_is_not_identifiable_is_large(
    decoder_data: Data, limit: float, identifiable: bool
):
    column = PARAMETERS.index("torque_limit")
    motors = truth()
    motors[:, column] = np.log(limit / 1.5)
    runs = WindowRuns(decoder_data(true_box(), motors, segments=5, rows=400), PRESET)

    fits = fit_motors(runs, (), True, 0)

    fitted_limit = np.exp((fits.center + fits.offsets)[:, column])
    if identifiable:
        np.testing.assert_allclose(fitted_limit, limit, rtol=0.15)
    else:
        kp = 10.0 * np.exp(motors[:, PARAMETERS.index("kp")])
        requested_torque = kp * runs.max_request
        assert np.all(fitted_limit > 3.0 * requested_torque)


def bytes_of(fits: MotorFits) -> bytes:
    return b"".join(array.tobytes() for array in (fits.center, fits.offsets, fits.loss))


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(
    runs: WindowRuns, monkeypatch: pytest.MonkeyPatch
):
    def fitted(seed: int, num_threads: int) -> MotorFits:
        with ThreadPoolExecutor(num_threads) as pool:
            monkeypatch.setattr(window_runs, "threads", lambda: pool)
            return fit_motors(runs, (), True, seed, restarts=2)

    fits = fitted(seed=5, num_threads=1)

    assert bytes_of(fitted(seed=5, num_threads=3)) == bytes_of(fits)
    assert fitted(seed=6, num_threads=3).offsets.tobytes() != fits.offsets.tobytes()


class _TwoOptima:
    """Five motors with two constants; the loss is the same at -2 and 2 of the first one."""

    count = 5
    weight = 1.0
    observations = 10

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        return np.stack(
            [x[:, 0] ** 2 - 4.0, x[:, 1] - 0.1 * problems, np.full(len(x), 0.5)], axis=1
        )


def test_a_motor_with_two_equal_optima_gets_the_one_near_other_motors():
    search = Search(_TwoOptima())
    no_prior = np.zeros(2)
    first_constant = [2.0, 2.0, 2.0, 2.0, -2.0]
    x = np.stack([first_constant, 0.1 * np.arange(5)], axis=1)
    fit = search.at(x, GaussianPrior(no_prior, no_prior))

    def searched(classes: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(0)
        return searched_near_others(search, rng, fit, no_prior > 0.0, classes, 12).x

    every_motor_alone = searched(np.arange(5))
    last_two_in_a_class = searched(np.array([0, 1, 2, 3, 3]))

    # the first four are probable, and only the last one changes
    assert every_motor_alone[:4].tobytes() == x[:4].tobytes()
    np.testing.assert_allclose(every_motor_alone[4], [2.0, 0.4], atol=0.15)

    # a motor that is not alone in its class keeps its optimum
    assert last_two_in_a_class.tobytes() == x.tobytes()
