"""A load that nobody weighed: found with its motor, with deviations that hold, or refused."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from swinging_bars import HANGS_AT, INERTIA, WEIGHT, Bars, swing

from motorprior.exceptions import LogError
from motorprior.identification import load_fit
from motorprior.identification.load_fit import FittedLoad, fit_loads, with_fitted_loads
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import POSTURES


@pytest.fixture(scope="module")
def bars() -> Bars:
    return swing(12.0)


@dataclass(frozen=True)
class Found:
    loss: np.ndarray
    start: int


def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit as if it did not matter how well."""
    monkeypatch.setattr(load_fit, "STARTS", 1)
    monkeypatch.setattr(load_fit, "FIRST_ROUNDS", 1)
    monkeypatch.setattr(load_fit, "ROUNDS", 1)


def test_inertia_and_weight_are_found_within_their_deviations(bars: Bars):
    for load, inertia, gravity, weight in zip(fit_loads(bars.log), INERTIA, bars.gravity, WEIGHT, strict=True):
        off = np.log(load.inertia / inertia)
        assert abs(off) < 3.0 * load.inertia_deviation < 1.0
        away = load.gravity - gravity
        assert away @ np.linalg.solve(load.gravity_covariance, away) < 9.0
        assert np.all(np.sqrt(np.diagonal(load.gravity_covariance)) < 0.2 * weight)
        assert load.error < 3e-3


def test_the_best_of_the_starts_is_fitted_on(monkeypatch: pytest.MonkeyPatch):
    rounds = []

    class Start:
        def __init__(self, *given):
            self.start = given[3]

        def begin(self):
            return Found(np.array([abs(self.start - 1.0)]), self.start)

        def rounds(self, found: "Found", most: int):
            rounds.append((found.start, most))
            return found

    monkeypatch.setattr(load_fit, "_Search", Start)
    nothing: Any = None
    best: Any = load_fit._search(nothing, nothing, nothing, nothing)
    first = [(start, load_fit.FIRST_ROUNDS) for start in range(load_fit.STARTS)]
    assert best.start == 1 and load_fit.STARTS > 2 and rounds == [*first, (1, load_fit.ROUNDS)]
    assert sum(most for _, most in rounds) == load_fit.MOST_ROUNDS


def test_registers_that_the_log_states_are_the_motors(monkeypatch: pytest.MonkeyPatch):
    bars = swing(12.0, profile_speed=1.2)
    (told,) = fit_loads(bars.log.joint(1))
    assert abs(np.log(told.inertia / INERTIA[1])) < 3.0 * told.inertia_deviation < 1.0
    assert np.all(np.abs(told.gravity - bars.gravity[1]) < 0.05 * WEIGHT[1]) and told.error < 1e-3
    quick(monkeypatch)
    (untold,) = fit_loads(replace(bars.log, firmware={}).joint(1))
    assert untold.error > 10.0 * told.error


def test_a_voltage_that_the_log_states_is_not_taken_for_the_load():
    """The gains that it states are those at the usual voltage, here in the middle."""
    shares = (1.125, 0.875)
    logs = [swing(6.0, law=law).log for law in shares]
    volts = [np.full(log.joint_pos.shape, 12.0 * law) for log, law in zip(logs, shares, strict=True)]
    both = joined([replace(log, supply_voltage=volt) for log, volt in zip(logs, volts, strict=True)])
    (told,) = fit_loads(both.joint(1))
    (untold,) = fit_loads(replace(both, supply_voltage=None).joint(1))
    assert told.error < 0.3 * untold.error
    assert np.all(np.abs(told.gravity - swing(1.0).gravity[1]) < 0.1 * WEIGHT[1])


def test_a_joint_is_fitted_by_itself_and_a_current_says_nothing(bars: Bars, monkeypatch: pytest.MonkeyPatch):
    quick(monkeypatch)
    both = fit_loads(bars.log)
    noise = np.random.default_rng(0).standard_normal(bars.log.joint_pos.shape)
    (alone,) = fit_loads(replace(bars.log, joint_torque=noise).joint(1))
    assert alone.inertia == both[1].inertia and alone.error == both[1].error
    np.testing.assert_array_equal(alone.gravity, both[1].gravity)


def test_the_log_carries_the_fitted_loads():
    bars = swing(1.0)
    given = [
        FittedLoad(inertia, 0.0, 0.0, gravity, np.eye(2), 0.0)
        for inertia, gravity in zip(INERTIA, bars.gravity, strict=True)
    ]
    log = with_fitted_loads(replace(bars.log, joint_torque=np.zeros_like(bars.log.joint_pos)), given)
    assert log.load_inertia is not None and log.external_torque is not None and log.load_stiffness is not None
    np.testing.assert_array_equal(log.load_inertia, np.tile(INERTIA, (log.num_rows, 1)))
    pull = -WEIGHT * np.sin(log.joint_pos - HANGS_AT)
    np.testing.assert_allclose(log.external_torque[:-1], 0.5 * (pull[:-1] + pull[1:]), atol=1e-12)
    np.testing.assert_allclose(log.external_torque[-1], pull[-1], atol=1e-12)
    np.testing.assert_allclose(log.load_stiffness, -WEIGHT * np.cos(log.joint_pos - HANGS_AT), atol=1e-12)
    assert log.joint_torque is None, "a motor's current is not the torque on the joint"
    assert log.posture is not None and np.all(log.posture == POSTURES.index("fixed"))


def test_what_shows_no_load_is_refused():
    log = swing(1.0).log
    still = log.joint_pos.copy()
    still[:, 1] = 0.3
    refused = {
        "no kp is stated": replace(log, stated_kp=None, stated_kd=None),
        "in firmware units": replace(log, gain_unit="firmware"),
        "joint right stood still": replace(log, joint_pos=still),
    }
    for words, other in refused.items():
        with pytest.raises(LogError, match=words):
            fit_loads(other)
