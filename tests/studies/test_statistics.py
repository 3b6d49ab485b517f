"""Statistics of policies: closed forms, textbook examples, and intervals that cover the truth."""

import numpy as np
import pytest
from scipy.special import ndtr

from motorprior.studies.statistics import (
    compare_scores,
    estimate,
    holm,
    means,
    permutation_p,
)


def studies(count: int, benches: int = 4, seeds: int = 4, draws: int = 16):
    """Pairs of scores around 0 of two conditions.

    Scores have effects of the bench, of bench and condition, of the policy and of the walk.
    """
    rng = np.random.default_rng(11)

    def effect(*shape: int) -> np.ndarray:
        return 0.05 * rng.standard_normal(shape)

    for _ in range(count):
        bench_effect = effect(benches, 1, 1)
        scores = []
        for _ in range(2):
            condition_effect = effect(benches, 1, 1)
            policy_effect = effect(benches, seeds, 1)
            walk_effect = effect(benches, seeds, draws)
            scores.append(bench_effect + condition_effect + policy_effect + walk_effect)
        yield scores


def test_means_are_over_the_finite_scores():
    assert means(np.array([np.nan, 3.0, 1.0, np.nan, 2.0])) == 2.0
    assert np.isnan(means(np.full(3, np.nan)))
    np.testing.assert_allclose(means(np.array([[1.0, np.nan, 3.0], [1.0, 1.0, 40.0]])), [2.0, 14.0])


def test_intervals_have_their_nominal_coverage():
    mean_covered = []
    difference_covered = []
    for scores, reference_scores in studies(400):
        mean = estimate(scores)
        mean_covered.append(mean.low <= 0.0 <= mean.high)
        difference = compare_scores(scores, reference_scores).difference
        difference_covered.append(difference.low <= 0.0 <= difference.high)

    assert 0.92 < np.mean(mean_covered) < 0.98
    assert 0.92 < np.mean(difference_covered) < 0.98


def test_the_interval_of_a_single_bench_is_over_its_samples():
    rng = np.random.default_rng(1)
    robots = rng.standard_normal(16)
    scores = robots + np.array([0.0, 1.0])[None, :, None]

    interval = estimate(scores)

    # 97.5 % quantile of Student's t with 15 degrees of freedom, over √16
    half_width = 2.131 * robots.std(ddof=1) / 4
    middle = robots.mean() + 0.5
    bounds = [middle - half_width, middle + half_width]
    assert [interval.low, interval.high] == pytest.approx(bounds, rel=1e-3)


def test_a_single_bench_has_a_difference_but_no_p():
    scores = np.random.default_rng(2).standard_normal((1, 3, 8))

    comparison = compare_scores(scores + 1.0, scores)

    assert comparison.difference.value == pytest.approx(1.0)
    assert np.isnan(comparison.p)


def test_the_corrected_family_wise_error_is_at_its_level():
    rng = np.random.default_rng(5)
    normal = 0.6 * rng.standard_normal((4000, 1)) + 0.8 * rng.standard_normal((4000, 12))
    has_error = []
    for p_values in ndtr(normal):
        corrected = holm(dict(enumerate(p_values)))
        has_error.append(min(corrected.values()) < 0.05)

    assert 0.02 < np.mean(has_error) < 0.055


def test_p_values_of_few_policies_have_their_lower_bound():
    assert permutation_p(np.ones((1, 2)), np.zeros((1, 2))) == pytest.approx(1 / 3, rel=0.05)
    two_benches = permutation_p(np.ones((2, 2)), np.zeros((2, 2)))
    assert two_benches == pytest.approx(1 / 3 * 1 / 3 / 2 * 1, rel=0.1)
    assert permutation_p(np.ones((4, 4)), np.zeros((4, 4))) == pytest.approx(1 / 20_001)
    assert permutation_p(np.ones((1, 1)), np.zeros((1, 1))) == 1.0


def test_policies_are_exchanged_within_their_bench_only():
    benches = np.array([[0.0], [10.0]])
    low = benches + np.arange(4) / 100
    high = benches + np.arange(4, 8) / 100

    assert permutation_p(low, high) < 0.01
    assert permutation_p(low.reshape(1, -1), high.reshape(1, -1)) > 0.5, "one bench"


def test_corrected_p_values_are_the_textbook_example_of_holm():
    """Four tests: .005 · 4, .01 · 3, .03 · 2, and .04, which must not fall below .03 · 2."""
    corrected = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert corrected == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert holm({"a": 0.6, "b": 0.9}) == {"a": 1.0, "b": 1.0} and holm({}) == {}
