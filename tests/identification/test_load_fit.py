"""An unknown load is fitted together with its motor, within its standard deviations."""

import numpy as np
import pytest
from swinging_bars import INERTIA, WEIGHT, Bars, swing

from motorprior.identification.load_fit import fit_loads


@pytest.fixture(scope="module")
def bars() -> Bars:
    return swing(12.0)


def test_inertia_and_weight_are_recovered_within_three_deviations(bars: Bars):
    loads = fit_loads(bars.log)

    for load, inertia, gravity, weight in zip(loads, INERTIA, bars.gravity, WEIGHT, strict=True):
        inertia_error = np.log(load.inertia / inertia)
        assert abs(inertia_error) < 3.0 * load.inertia_deviation < 1.0

        gravity_error = load.gravity - gravity
        squared_distance = gravity_error @ np.linalg.solve(load.gravity_covariance, gravity_error)
        assert squared_distance < 3.0**2

        gravity_deviation = np.sqrt(np.diagonal(load.gravity_covariance))
        assert np.all(gravity_deviation < 0.2 * weight)
        assert load.error < 3e-3
