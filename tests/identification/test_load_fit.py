"""An unknown load is fitted together with its motor, within its standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
from swinging_bars import HANGS_AT, INERTIA, WEIGHT, Bars, swing

from motorprior.identification.load_fit import FittedLoad, fit_loads, with_fitted_loads
from motorprior.logs.motor_log import POSTURES


@pytest.fixture(scope="module")
def bars() -> Bars:
    return swing(12.0)


def test_inertia_and_weight_are_found_within_their_deviations(bars: Bars):
    for load, inertia, gravity, weight in zip(fit_loads(bars.log), INERTIA, bars.gravity, WEIGHT, strict=True):
        off = np.log(load.inertia / inertia)
        assert abs(off) < 3.0 * load.inertia_deviation < 1.0
        away = load.gravity - gravity
        assert away @ np.linalg.solve(load.gravity_covariance, away) < 9.0
        assert np.all(np.sqrt(np.diagonal(load.gravity_covariance)) < 0.2 * weight)
        assert load.error < 3e-3


def test_the_log_has_the_fitted_loads():
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
