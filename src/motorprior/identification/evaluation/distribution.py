"""Whether a motor prior matches a fleet: two-sample tests of behaviour features.

Features are standardised by the median and the interquartile range of the pooled samples, x' = (x - median) / (IQR /
1.349), so that results do not depend on units and the permutation test is exact. If the interquartile range is 0,
the standard deviation is used, or 1 if that is 0 as well.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

# of the classifier: bound on a standardised feature, against diverged motors; ridge penalty per training motor
_CLIP, _RIDGE = 4.0, 0.02
_FOLDS, _REPEATS, _NEWTON_STEPS = 5, 4, 8


def standardise(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both samples (n, F) and (m, F), standardised by their pooled median and spread [-]; see the module docstring."""
    pooled = np.concatenate([a, b])
    low, middle, high = np.quantile(pooled, [0.25, 0.5, 0.75], axis=0)
    deviation = pooled.std(axis=0)
    spread = np.where(high > low, (high - low) / 1.349, np.where(deviation > 0, deviation, 1.0))
    return (a - middle) / spread, (b - middle) / spread


def _distances(points: np.ndarray) -> np.ndarray:
    """(N, N) Euclidean distances of (N, F) points."""
    return np.sqrt(np.sum(np.square(points[:, None, :] - points[None, :, :]), axis=2))


def _energy(distances: np.ndarray, in_a: np.ndarray) -> np.ndarray:
    """(P,) energy distances for P labellings (P, N) of N points as sample a (True) or b (False).

    2·E|X - Y| - E|X - X'| - E|Y - Y'| = -wᵀDw with w = 1/n on a, -1/m on b.
    """
    count = in_a.sum(axis=1, keepdims=True)
    weights = np.where(in_a, 1.0 / count, -1.0 / (in_a.shape[1] - count))
    return np.maximum(-np.sum(weights @ distances * weights, axis=1), 0.0)


def energy_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Squared energy distance of two standardised samples (n, F) and (m, F) [-].

    2·E|X - Y| - E|X - X'| - E|Y - Y'|, averaged over all pairs, pairs of a point with itself included (Székely & Rizzo,
    Energy statistics, J. Stat. Plan. Inference 143, 2013): non-negative, O(1/n + 1/m) for equal distributions.
    """
    return float(_energy(_distances(np.concatenate(standardise(a, b))), _labels(len(a), len(b))[None])[0])


def permutation_p_value(a: np.ndarray, b: np.ndarray, seed: int, permutations: int = 200) -> float:
    """p-value of the energy distance: the probability of one as large if a and b had one distribution [-].

    (1 + number of permuted labellings with a distance at least as large) / (1 + permutations); uniform under the null.
    """
    distances = _distances(np.concatenate(standardise(a, b)))
    labels, rng = _labels(len(a), len(b)), np.random.default_rng(seed)
    shuffled = np.stack([labels, *(rng.permutation(labels) for _ in range(permutations))])
    observed, *null = _energy(distances, shuffled)
    return (1 + int(np.sum(np.array(null) >= observed - 1e-12))) / (1 + permutations)


def _labels(count_a: int, count_b: int) -> np.ndarray:
    """(n + m,) labels, True for the first sample."""
    return np.arange(count_a + count_b) < count_a


def two_sample_auc(a: np.ndarray, b: np.ndarray, seed: int) -> float:
    """Area under the ROC curve of a classifier that separates motors of ``a`` (n, F) from those of ``b`` (m, F) [-].

    0.5: inseparable; 1: always separable (Lopez-Paz & Oquab, Revisiting Classifier Two-Sample Tests, ICLR 2017). The
    classifier is a ridge logistic regression on the standardised features, their squares and pairwise products, which
    detects differences in location, scale and correlation. The result is the mean AUC of the held-out motors over
    stratified cross-validation folds and repeats. For equal distributions its standard deviation around 0.5 is 1.0 to
    1.4 times √((n + m + 1) / (12·n·m)), that of a fixed score (Mann & Whitney 1947).
    """
    features = _quadratic(np.clip(np.concatenate(standardise(a, b)), -_CLIP, _CLIP))
    labels, rng, areas = _labels(len(a), len(b)), np.random.default_rng(seed), []
    for _ in range(_REPEATS):
        fold = np.concatenate([rng.permutation(np.arange(count) % _FOLDS) for count in (len(a), len(b))])
        for held_out in range(_FOLDS):
            test = fold == held_out
            weights = _fit_logistic(features[~test], labels[~test])
            areas.append(area_under_curve(features[test & labels] @ weights, features[test & ~labels] @ weights))
    return float(np.mean(areas))


def feature_auc(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(F,) AUC of each feature alone, P(a's value > b's) + P(equal)/2 [-]: below 0.5 where ``a`` has lower values.

    It identifies the feature that makes `two_sample_auc` large, but misses differences of spread and correlation.
    """
    return np.array([area_under_curve(one, other) for one, other in zip(a.T, b.T, strict=True)])


def area_under_curve(positive: np.ndarray, negative: np.ndarray) -> float:
    """Area under the ROC curve, P(score of a positive > score of a negative) + P(equal)/2 [-], from ranks."""
    n, m = len(positive), len(negative)
    ranks = rankdata(np.concatenate([positive, negative]))
    return float((ranks[:n].sum() - 0.5 * n * (n + 1)) / (n * m))


def _quadratic(features: np.ndarray) -> np.ndarray:
    """(N, 1 + F + F·(F+1)/2) columns: 1, the features, and their squares and products, scaled to unit spread."""
    first, second = np.triu_indices(features.shape[1])
    products = features[:, first] * features[:, second]
    products = (products - products.mean(axis=0)) / np.maximum(products.std(axis=0), 1.0)
    return np.concatenate([np.ones((len(features), 1)), features, products], axis=1)


def _fit_logistic(features: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(K,) weights of a ridge logistic regression of labels (N,) on features (N, K), by Newton's method.

    Column 0 of the features is 1. Each class has half of the total weight.
    """
    penalty = np.full(features.shape[1], _RIDGE * len(features))
    penalty[0] = 1e-6
    share = np.where(labels, 0.5 / labels.mean(), 0.5 / (1.0 - labels.mean()))
    weights = np.zeros(features.shape[1])
    for _ in range(_NEWTON_STEPS):
        probability = 0.5 * (1.0 + np.tanh(0.5 * np.clip(features @ weights, -30.0, 30.0)))
        gradient = features.T @ (share * (probability - labels)) + penalty * weights
        curvature = (features.T * (share * probability * (1.0 - probability))) @ features + np.diag(penalty)
        weights = weights - np.linalg.solve(curvature, gradient)
    return weights
