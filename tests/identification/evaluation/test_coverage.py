"""Bands of samples have their nominal coverage."""

import numpy as np
import pytest

from motorprior.identification.evaluation.coverage import DRAWS, band


@pytest.mark.parametrize("level", [50, 90])
@pytest.mark.parametrize("kind", ["normal", "exponential"])
def test_a_band_of_few_samples_has_its_nominal_coverage(level: int, kind: str):
    rng = np.random.default_rng(level)
    sample = getattr(rng, "standard_" + kind)((DRAWS + 1, 200, 100))
    low, high = band(sample[:-1], level)
    inside = np.mean((sample[-1] >= low) & (sample[-1] <= high))
    assert inside == pytest.approx(level / 100, abs=0.01)  # 20,000 trials: three standard errors
