"""Statistics of policies: closed forms, textbook examples, and intervals that cover the truth."""

import numpy as np
import pytest
from scipy.stats import permutation_test, trim_mean

from motorprior.transfer.permutation_tests import holm, permutation_p, sign_p
from motorprior.transfer.statistics import (
    Comparison,
    Estimate,
    compare_on_robots,
    compare_pairs,
    compare_scores,
    estimate,
    improvement,
    iqm,
    iqms,
    means,
    profile,
    ratio,
)


def studies(count: int, seeds: int = 8, draws: int = 16, spread: float = 0.05, luck: float = 0.03):
    """Scores around 0 with an effect of the policy, of the draw and of both."""
    rng = np.random.default_rng(11)
    for _ in range(count):
        of_draws = luck * rng.standard_normal(draws)
        yield [
            spread * rng.standard_normal((seeds, 1)) + of_draws + 0.05 * rng.standard_normal((seeds, draws))
            for _ in range(2)
        ]


def test_the_interquartile_mean_is_that_of_the_middle_half():
    assert iqm(np.array([[100.0, 3.0, 1.0, 4.0], [2.0, -100.0, 5.0, 6.0]])) == np.mean([2, 3, 4, 5])
    assert iqm(np.array([1.0, 2.0, 9.0])) == 4.0  # nothing to leave out
    assert iqm(np.array([[7.0]])) == 7.0


@pytest.mark.parametrize("count", range(1, 14))
def test_the_interquartile_mean_is_scipys_trimmed_mean(count: int):
    scores = np.random.default_rng(count).standard_normal(count)
    assert iqm(scores) == pytest.approx(trim_mean(scores, 0.25))


def test_what_is_not_known_counts_neither_as_high_nor_as_low():
    known = np.array([3.0, 1.0, 2.0, 5.0, 4.0])
    with_gaps = np.array([np.nan, 3.0, 1.0, np.nan, 2.0, 5.0, np.inf, 4.0])
    assert iqm(np.where(np.isinf(with_gaps), np.nan, with_gaps)) == iqm(known) == 3.0
    assert means(with_gaps) == 3.0
    assert np.isnan(iqm(np.full(3, np.nan)))
    rows = iqms(np.array([[1.0, np.nan, 3.0, np.nan], [1.0, 1.0, 2.0, 40.0]]))
    np.testing.assert_allclose(rows, [2.0, 1.5])


def test_an_interval_covers_the_truth_about_as_often_as_it_says():
    found = [estimate(one, resamples=300) for one, _ in studies(200)]
    covered = np.mean([each.low <= 0.0 <= each.high for each in found])
    assert 0.86 < covered < 0.995
    assert all(each.low <= each.value <= each.high for each in found)


@pytest.mark.parametrize(("standing", "least", "most"), [(0.5, 0.85, 0.97), (0.75, 0.83, 0.96), (0.9, 0.4, 0.7)])
def test_where_policies_stand_or_fall_an_interval_covers_less_than_it_says(standing: float, least: float, most: float):
    """docs/transfer.md says so. Of eight policies that stand nine times of ten often all do: then it has no width."""
    rng, truth = np.random.default_rng(0), standing + 0.4 * (1.0 - standing)
    covered = 0
    for _ in range(300):
        scores = np.where(rng.random((8, 1)) < standing, 1.0, 0.4) + np.zeros((8, 4))
        found = estimate(scores, means, resamples=400)
        covered += found.low - 1e-9 <= truth <= found.high + 1e-9
    assert least < covered / 300 < most


def test_without_a_difference_few_comparisons_find_one():
    p = np.array([compare_scores(one, other, resamples=2).p for one, other in studies(200)])
    assert np.mean(p < 0.05) < 0.09 and 0.4 < np.mean(p < 0.5) < 0.6


def test_a_study_without_differences_seldom_finds_one_after_the_correction():
    """Where policies differ and draws do not: a bootstrap of policies finds one in four of ten such studies."""
    rng, found = np.random.default_rng(5), 0
    for _ in range(400):
        of_policies = rng.standard_normal((2, 6, 1))  # what a policy does on a twin it does on the others, in part
        scores = 0.7 * of_policies + 0.7 * rng.standard_normal((2, 6, 12))
        p_values = {twin: permutation_p(*scores[:, :, twin]) for twin in range(12)}
        found += min(holm(p_values).values()) < 0.05
    assert 0.002 < found / 400 < 0.075


@pytest.mark.parametrize(("first", "second"), [(4, 4), (3, 6), (2, 5)])
def test_the_test_is_scipys(first: int, second: int):
    rng = np.random.default_rng(first)
    one, other = rng.standard_normal(first) + 0.7, rng.standard_normal(second)

    def difference(a: np.ndarray, b: np.ndarray, axis: int) -> np.ndarray:
        return np.abs(a.mean(axis=axis) - b.mean(axis=axis))

    wanted = permutation_test((one, other), difference, vectorized=True, n_resamples=10_000, alternative="greater")
    assert permutation_p(one, other) == permutation_p(other, one) == pytest.approx(wanted.pvalue)


def test_few_policies_are_never_sure():
    assert permutation_p(np.ones(2), np.zeros(2)) == pytest.approx(1 / 3)
    assert permutation_p(np.ones(8), np.zeros(8)) == pytest.approx(2 / 12_870)
    assert permutation_p(np.ones(12), np.zeros(12)) == pytest.approx(1 / 20_000), "of so many ways some are drawn"
    assert permutation_p(np.array([np.nan]), np.ones(3)) == 1.0
    assert permutation_p(np.array([1.0, np.nan, 1.0]), np.zeros(2)) == pytest.approx(1 / 3)


def test_draws_that_a_policy_shares_make_the_interval_wider():
    """The walks of a policy are no independent ones: of 4 policies there are 4, however often they walk."""
    policies = np.array([0.1, 0.2, 0.3, 0.4])[:, None] + np.zeros((4, 200))
    nested, naive = estimate(policies), estimate(policies.reshape(-1, 1))
    assert nested.high - nested.low > 4.0 * (naive.high - naive.low) > 0.0


def test_the_draws_are_resampled_too():
    """Of one policy on two robots nobody knows how it does on a third."""
    found = estimate(np.array([[0.0, 1.0]]))
    assert (found.low, found.high) == (0.0, 1.0)


def test_the_same_scores_give_the_same_interval():
    scores = np.random.default_rng(0).standard_normal((3, 5))
    assert estimate(scores) == estimate(scores.copy())


def test_shared_draws_tell_more():
    rng = np.random.default_rng(3)
    luck = rng.standard_normal(12)
    one, other = (luck + level + 0.02 * rng.standard_normal((4, 12)) for level in (0.2, 0.0))
    shared, apart = compare_scores(one, other, True), compare_scores(one, other, False)
    assert shared.difference.low > 0.1 > 0.0 > apart.difference.low
    assert shared.difference.value == apart.difference.value == pytest.approx(0.2, abs=0.05)
    assert shared.improvement == 1.0 > apart.improvement


def test_a_comparison_turned_around_has_the_other_sign():
    one, other = next(studies(1))
    there, back = compare_scores(one, other), compare_scores(other, one)
    assert there.difference.value == -back.difference.value
    assert there.improvement == pytest.approx(1.0 - back.improvement)
    assert there.p == back.p
    assert there.turned().turned().difference == there.difference and there.turned().p == there.p


def test_equal_scores_do_not_differ():
    found = compare_scores(np.ones((3, 4)), np.ones((3, 4)))
    assert (found.p, found.improvement, found.difference.value) == (1.0, 0.5, 0.0)


def test_the_smallest_p_value_survives_the_correction_of_a_study():
    found = compare_scores(np.ones((8, 32)), np.zeros((8, 32)))
    comparisons_of_targets = 2 * 2 * 3 * 4  # ways to use the prior, rivals, measures, twins
    assert comparisons_of_targets * found.p < 0.05


def test_robots_of_adapted_policies_are_resampled_with_those_of_others():
    rng = np.random.default_rng(0)
    robots = rng.uniform(0.0, 1.0, 8)
    adapted, others = robots[:, None] + np.zeros((8, 4)) + 0.1, robots + np.zeros((5, 8))
    found = compare_on_robots(adapted, others, means)
    assert [found.difference.low, found.difference.value, found.difference.high] == pytest.approx([0.1] * 3)
    assert found.p == pytest.approx(2 / 1287, rel=0.51), "8 of one, 5 of the other"
    assert found.improvement == 1.0, "on its own robot, however much the robots differ"
    with pytest.raises(ValueError, match="8 robots against 3"):
        compare_on_robots(adapted, np.zeros((5, 3)))


def test_scores_that_are_not_known_decide_nothing():
    found = compare_scores(np.full((2, 3), np.nan), np.ones((2, 3)))
    assert found.p == 1.0 and np.isnan(found.difference.value) and np.isnan(found.improvement)
    gaps = np.ones((2, 3))
    gaps[0, 0] = np.nan
    assert compare_scores(gaps, np.zeros((2, 3))).difference.value == 1.0


def test_improvement_counts_ties_half():
    one, other = np.array([[1.0, 2.0], [3.0, 0.0]]), np.array([[1.0, 1.0]])
    assert improvement(one, other) == (0.5 + 1.0 + 1.0 + 0.0) / 4
    assert improvement(np.array([[1.0, 2.0]]), np.array([[1.0], [3.0]]), shared=False) == (0.5 + 0 + 1 + 0) / 4


def test_holm_is_the_textbooks():
    """Four tests: .005 · 4, .01 · 3, .03 · 2, and .04, which must not fall below the one before it."""
    corrected = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert corrected == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert list(corrected) == ["a", "b", "c", "d"]
    assert holm({"a": 0.6, "b": 0.9}) == {"a": 1.0, "b": 1.0}
    assert holm({}) == {}


def test_a_ratio_keeps_policies_together():
    """Every policy keeps half of its speed: there is nothing uncertain, though the speeds differ."""
    own = np.array([[0.2], [0.4], [0.8]]) + np.zeros((3, 4))
    found = ratio(0.5 * own, own, 0.02)
    assert (found.value, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5))


def test_a_ratio_of_policies_that_differ_is_uncertain():
    shares, own = np.array([[0.2], [0.9]]) + np.zeros((2, 4)), np.full((2, 4), 0.5)
    found = ratio(shares * own, own, 0.02)
    assert (found.low, found.high) == pytest.approx((0.2, 0.9))


def test_a_policy_that_does_not_walk_has_no_ratio_and_one_that_hardly_does_no_interval():
    assert np.isnan(ratio(np.full((2, 3), 0.3), np.full((2, 1), 0.01), 0.02).value)
    there, own = np.full((2, 3), 0.3), np.array([[0.01], [0.1]])
    for least, value in ((0.06, np.nan), (0.02, 0.3 / 0.055)):  # a quarter of the resamples has the first policy only
        found = ratio(there, own, least)
        assert found.value == pytest.approx(value, nan_ok=True) and np.isnan(found.low) and np.isnan(found.high)
    unsure = Comparison(Estimate(0.1, np.nan, np.nan), 0.9, 0.001)
    assert not unsure.is_sure(0.001) and Comparison(Estimate(0.1, 0.05, 0.2), 0.9, 0.001).is_sure(0.001)
    with pytest.raises(ValueError, match="2 policies against 3"):
        ratio(np.ones((2, 3)), np.ones((3, 3)), 0.02)


def test_a_profile_counts_the_walks_above():
    scores = np.array([[0.1, 0.2], [0.3, np.nan]])
    np.testing.assert_array_equal(profile(scores, np.array([0.0, 0.1, 0.25, 0.3])), [0.75, 0.5, 0.25, 0.0])


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="no scores"):
        estimate(np.zeros((0, 0)))
    with pytest.raises(ValueError, match="no scores"):
        compare_scores(np.zeros((1, 1)), np.zeros((0, 0)), shared=False)
    with pytest.raises(ValueError, match="2 draws against 3"):
        compare_scores(np.zeros((1, 2)), np.zeros((1, 3)))


def test_signs_of_pairs_are_changed_in_all_ways():
    """Of 2^3 ways to give signs to 1, 2 and 3 two have a sum of 6 or -6; four of 2^2 of 1 and 1 with an unknown one."""
    assert sign_p(np.array([1.0, 2.0, 3.0])) == 2 / 8
    assert sign_p(np.array([1.0, np.nan, 1.0])) == 2 / 4
    assert sign_p(np.array([1.0, -1.0])) == 1.0
    assert sign_p(np.array([np.nan])) == 1.0


def test_of_many_pairs_some_ways_are_enough():
    differences = np.random.default_rng(3).standard_normal(40)
    exact = permutation_test((differences,), np.sum, permutation_type="samples", n_resamples=100_000, rng=0)
    assert sign_p(differences) == pytest.approx(exact.pvalue, abs=0.02)
    assert sign_p(differences + 2.0) == 1 / 20_000, "only the way they are"


def test_robots_that_differ_more_than_policies_hide_nothing_from_a_comparison_of_pairs():
    rng = np.random.default_rng(5)
    robots = rng.standard_normal((8, 1)) + 0.01 * rng.standard_normal((8, 16))
    better = robots + 0.1 + 0.01 * rng.standard_normal((8, 16))
    paired, apart = compare_pairs(better, robots), compare_scores(better, robots)
    assert paired.p == 2 / 256 and paired.difference.low > 0.05 and paired.improvement == 1.0
    assert apart.p > 0.5
    with pytest.raises(ValueError, match="against"):
        compare_pairs(better, robots[:4])
