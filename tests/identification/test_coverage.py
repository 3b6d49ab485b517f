"""A band of draws holds one more draw of the same distribution as often as it promises."""

import numpy as np
import pytest

from motorprior.identification.coverage import DRAWS, band


@pytest.mark.parametrize("level", [50, 90])
@pytest.mark.parametrize("kind", ["normal", "exponential"])
def test_a_band_of_few_draws_holds_what_it_promises(level: int, kind: str):
    rng = np.random.default_rng(level)
    sample = getattr(rng, "standard_" + kind)((DRAWS + 1, 200, 100))
    low, high = band(sample[:-1], level)
    inside = np.mean((sample[-1] >= low) & (sample[-1] <= high))
    assert inside == pytest.approx(level / 100, abs=0.01)  # 20,000 trials: three standard errors


def test_a_wider_band_holds_a_narrower_one():
    draws = np.random.default_rng(0).standard_normal((DRAWS, 7))
    (low50, high50), (low90, high90) = (band(draws, level) for level in (50, 90))
    assert np.all(low90 < low50) and np.all(low50 < high50) and np.all(high50 < high90)
