"""A fit finds the constants of motors that a decoder made, with the same bytes on any number of threads."""

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
"""Standard deviations of the logarithms."""


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
def found(runs: WindowRuns) -> MotorFits:
    return fit_motors(runs, (), True, 0)


def test_the_constants_of_four_motors_are_found(found: MotorFits):
    assert found.loss.max() < 3e-3, found.loss
    error = np.abs(found.center + found.offsets - true_center() - truth())
    within = {
        "kp": 0.03,
        "kd_over_kp": 0.05,
        "delay": 0.03,
        "backlash": 0.08,
        "load_friction": 0.1,
        "armature": 0.1,
    }
    for name, bound in within.items():
        assert error[:, PARAMETERS.index(name)].max() < bound, (
            name,
            error[:, PARAMETERS.index(name)],
        )


def test_a_gain_far_from_the_initial_motor_is_found(decoder_data: Data):
    center = true_center()
    kp = PARAMETERS.index("kp")
    center[kp] += np.log(0.04)
    runs = WindowRuns(
        decoder_data(grey_box(center, (), PRESET), truth(), segments=5, rows=400), PRESET
    )
    found = fit_motors(runs, (), True, 0)
    # a factor of 25 away; fits on other processors differ by 0.2
    expected = center[kp] + truth()[:, kp]
    np.testing.assert_allclose((found.center + found.offsets)[:, kp], expected, atol=0.25)


@pytest.mark.parametrize(("limit", "identifiable"), [(60.0, False), (1.5, True)])
def test_a_torque_limit_that_is_not_identifiable_is_large(
    decoder_data: Data, limit: float, identifiable: bool
):
    column = PARAMETERS.index("torque_limit")
    motors = truth()
    motors[:, column] = np.log(limit / 1.5)
    runs = WindowRuns(decoder_data(true_box(), motors, segments=5, rows=400), PRESET)
    asked = 10.0 * np.exp(motors[:, PARAMETERS.index("kp")]) * runs.max_request
    fit = fit_motors(runs, (), True, 0)
    found = np.exp((fit.center + fit.offsets)[:, column])
    if identifiable:
        np.testing.assert_allclose(found, limit, rtol=0.15)
    else:
        assert np.all(found > 3.0 * asked)


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(
    runs: WindowRuns, monkeypatch: pytest.MonkeyPatch
):
    results = []
    for pool in (ThreadPoolExecutor(1), ThreadPoolExecutor(3)):
        monkeypatch.setattr(window_runs, "threads", lambda pool=pool: pool)
        one = fit_motors(runs, (), True, 5, restarts=2)
        results.append(b"".join(part.tobytes() for part in (one.center, one.offsets, one.loss)))
    assert results[0] == results[1]
    other = fit_motors(runs, (), True, 6, restarts=2)
    assert other.offsets.tobytes() not in results[0]


class _TwoOptima:
    """Five motors with two constants; the loss is the same at -2 and 2 of the first one."""

    count = 5
    weight = 1.0
    observations = 10

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        return np.stack(
            [x[:, 0] ** 2 - 4.0, x[:, 1] - 0.1 * problems, np.full(len(x), 0.5)], axis=1
        )


def test_of_two_optima_that_fit_alike_the_motor_gets_that_of_the_others():
    search = Search(_TwoOptima())
    wide = np.zeros(2)
    x = np.stack([[2.0, 2.0, 2.0, 2.0, -2.0], 0.1 * np.arange(5)], axis=1)
    found = search.at(x, GaussianPrior(wide, wide))
    changed, same = (
        searched_near_others(search, np.random.default_rng(0), found, wide > 0.0, classes, 12)
        for classes in (np.arange(5), np.array([0, 1, 2, 3, 3]))
    )
    assert changed.x[:4].tobytes() == x[:4].tobytes()  # the others are probable
    np.testing.assert_allclose(changed.x[4], [2.0, 0.4], atol=0.15)
    assert same.x.tobytes() == x.tobytes()  # it is not alone in its class
