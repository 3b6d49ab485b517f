"""Statistics of policies: closed forms, textbook examples, and intervals that cover the truth."""

import numpy as np
import pytest
from scipy.special import ndtr

from motorprior.studies import statistics
from motorprior.studies.statistics import compare_on_robots, compare_scores, estimate, holm, iqms, means, permutation_p


def studies(count: int, seeds: int = 8, draws: int = 16, spread: float = 0.05, luck: float = 0.03):
    """Scores around 0 with an effect of the policy, of the draw and of both."""
    rng = np.random.default_rng(11)
    for _ in range(count):
        of_draws = luck * rng.standard_normal(draws)
        yield [
            spread * rng.standard_normal((seeds, 1)) + of_draws + 0.05 * rng.standard_normal((seeds, draws))
            for _ in range(2)
        ]


def test_the_interquartile_mean_is_that_of_the_middle_half_of_the_finite_scores():
    assert iqms(np.array([100.0, 3.0, 1.0, 4.0, 2.0, -100.0, 5.0, 6.0])) == np.mean([2, 3, 4, 5])
    assert iqms(np.array([1.0, 2.0, 9.0])) == 4.0  # nothing to leave out
    with_gaps = np.array([np.nan, 3.0, 1.0, np.nan, 2.0, 5.0, 4.0])
    assert iqms(with_gaps) == means(with_gaps) == 3.0 and np.isnan(iqms(np.full(3, np.nan)))
    rows = iqms(np.array([[1.0, np.nan, 3.0, np.nan], [1.0, 1.0, 2.0, 40.0]]))
    np.testing.assert_allclose(rows, [2.0, 1.5])


def test_intervals_have_their_nominal_coverage(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(statistics, "BATCH", 150)
    found = [estimate(one) for one, _ in studies(200)]
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.86 < covered < 0.995
    assert all(each.low <= each.value <= each.high for each in found)


def test_the_corrected_family_wise_error_is_at_its_level():
    """Twelve correlated tests without a difference, in many studies."""
    rng = np.random.default_rng(5)
    normal = 0.6 * rng.standard_normal((4000, 1)) + 0.8 * rng.standard_normal((4000, 12))
    found = [min(holm(dict(enumerate(p_values))).values()) < 0.05 for p_values in ndtr(normal)]
    assert 0.02 < np.mean(found) < 0.055


def test_p_values_of_few_policies_have_their_lower_bound():
    assert permutation_p(np.ones(2), np.zeros(2)) == pytest.approx(1 / 3)
    assert permutation_p(np.ones(8), np.zeros(8)) == pytest.approx(2 / 12_870)
    assert permutation_p(np.ones(12), np.zeros(12)) == pytest.approx(1 / 20_001), "sampled permutations"
    assert permutation_p(np.array([np.nan, 0.0]), np.ones(3)) == 1.0
    assert permutation_p(np.array([1.0, np.nan, 1.0]), np.zeros(2)) == pytest.approx(1 / 3)


def test_walks_of_one_policy_are_not_independent():
    policies = np.array([0.1, 0.2, 0.3, 0.4])[:, None] + np.zeros((4, 200))
    nested, naive = estimate(policies), estimate(policies.reshape(-1, 1))
    assert nested.high - nested.low > 4.0 * (naive.high - naive.low) > 0.0


def test_shared_samples_narrow_the_interval():
    rng = np.random.default_rng(3)
    luck = rng.standard_normal(12)
    one, other = (luck + level + 0.02 * rng.standard_normal((4, 12)) for level in (0.2, 0.0))
    shared = compare_scores(one, other).difference
    assert shared.low > 0.1 and shared.value == pytest.approx(0.2, abs=0.05)
    assert estimate(one).low < estimate(other).high, "each interval alone contains the luck of the draws"


def test_robots_of_adapted_policies_are_resampled_with_those_of_others():
    rng = np.random.default_rng(0)
    robots = rng.uniform(0.0, 1.0, 8)
    adapted, others = robots[:, None] + np.zeros((8, 4)) + 0.1, robots + np.zeros((5, 8))
    found = compare_on_robots(adapted, others, means)
    assert [found.difference.low, found.difference.value, found.difference.high] == pytest.approx([0.1] * 3)
    assert found.p == pytest.approx(2 / 1287, rel=0.51), "8 of one, 5 of the other"


def test_holm_is_the_textbooks():
    """Four tests: .005 · 4, .01 · 3, .03 · 2, and .04, which must not fall below the one before it."""
    corrected = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert corrected == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert holm({"a": 0.6, "b": 0.9}) == {"a": 1.0, "b": 1.0} and holm({}) == {}
