"""An unknown load is fitted together with its motor, within its standard deviations."""

import numpy as np
import pytest
from swinging_bars import INERTIA, WEIGHT, Bars, swing

from motorprior.identification.load_fit import fit_loads


@pytest.fixture(scope="module")
def bars() -> Bars:
    return swing(12.0)


def test_inertia_and_weight_are_found_within_their_deviations(bars: Bars):
    for load, inertia, gravity, weight in zip(
        fit_loads(bars.log), INERTIA, bars.gravity, WEIGHT, strict=True
    ):
        off = np.log(load.inertia / inertia)
        assert abs(off) < 3.0 * load.inertia_deviation < 1.0
        away = load.gravity - gravity
        assert away @ np.linalg.solve(load.gravity_covariance, away) < 9.0
        assert np.all(np.sqrt(np.diagonal(load.gravity_covariance)) < 0.2 * weight)
        assert load.error < 3e-3
