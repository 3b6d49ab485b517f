"""Two-sample test: how well a classifier separates two samples of motors by their features."""

import numpy as np

# classifier: bound on a standardised feature, against diverged motors
_CLIP = 4.0
_RIDGE = 0.02  # ridge penalty per training motor
_FOLDS = 5
_REPEATS = 4
_NEWTON_STEPS = 8


def two_sample_auc(a: np.ndarray, b: np.ndarray, seed: int) -> float:
    """Area under the ROC curve of a classifier that separates motors of ``a`` from those of ``b``.

    0.5: inseparable; 1: always separable (Lopez-Paz & Oquab, Revisiting Classifier Two-Sample
    Tests, ICLR 2017). The classifier is a ridge logistic regression on the standardised features,
    their squares and pairwise products, which detects differences in location, scale and
    correlation. The result is the mean AUC of the held-out motors over stratified cross-validation
    folds and repeats. For equal distributions its standard deviation around 0.5 is 1.0 to 1.4 times
    √((n + m + 1) / (12·n·m)), the standard deviation for a fixed score (Mann & Whitney 1947).

    Args:
        a: (n, F) features.
        b: (m, F) features.
        seed: of the folds.
    """
    pooled = np.concatenate(standardise(a, b))
    features = _quadratic(np.clip(pooled, -_CLIP, _CLIP))
    labels = np.arange(len(a) + len(b)) < len(a)
    rng = np.random.default_rng(seed)

    areas = []
    for _ in range(_REPEATS):
        folds = [rng.permutation(np.arange(count) % _FOLDS) for count in (len(a), len(b))]
        fold = np.concatenate(folds)
        for held_out in range(_FOLDS):
            test = fold == held_out
            weights = _fit_logistic(features[~test], labels[~test])
            positive = features[test & labels] @ weights
            negative = features[test & ~labels] @ weights
            areas.append(area_under_curve(positive, negative))
    return float(np.mean(areas))


def standardise(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both samples (n, F) and (m, F), standardised by their pooled median and interquartile range.

    x' = (x - median) / (IQR / 1.349). If the interquartile range is 0, the standard deviation is
    used, or 1 if the standard deviation is 0 as well.
    """
    pooled = np.concatenate([a, b])
    low, middle, high = np.quantile(pooled, [0.25, 0.5, 0.75], axis=0)
    deviation = pooled.std(axis=0)
    fallback = np.where(deviation > 0, deviation, 1.0)
    scale = np.where(high > low, (high - low) / 1.349, fallback)
    return (a - middle) / scale, (b - middle) / scale


def area_under_curve(positive: np.ndarray, negative: np.ndarray) -> float:
    """Area under the ROC curve, P(score of a positive > score of a negative) + P(equal)/2 [-]."""
    from scipy.stats import mannwhitneyu  # here: it takes half a second to import

    pairs = mannwhitneyu(positive, negative, method="asymptotic").statistic
    return float(pairs / (len(positive) * len(negative)))


def _quadratic(features: np.ndarray) -> np.ndarray:
    """(N, 1 + F + F·(F+1)/2) columns: 1, the features, and their products, scaled to unit variance.

    The products include the squares.
    """
    first, second = np.triu_indices(features.shape[1])
    products = features[:, first] * features[:, second]
    products = (products - products.mean(axis=0)) / np.maximum(products.std(axis=0), 1.0)
    return np.concatenate([np.ones((len(features), 1)), features, products], axis=1)


def _fit_logistic(features: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(K,) weights of a ridge logistic regression of labels (N,) on features (N, K).

    The method is Newton's. Column 0 of the features is 1. Each class has half of the total weight.
    """
    penalty = np.full(features.shape[1], _RIDGE * len(features))
    penalty[0] = 1e-6
    share = np.where(labels, 0.5 / labels.mean(), 0.5 / (1.0 - labels.mean()))

    weights = np.zeros(features.shape[1])
    for _ in range(_NEWTON_STEPS):
        score = np.clip(features @ weights, -30.0, 30.0)
        probability = 0.5 * (1.0 + np.tanh(0.5 * score))
        gradient = features.T @ (share * (probability - labels)) + penalty * weights
        variance = share * probability * (1.0 - probability)
        curvature = (features.T * variance) @ features + np.diag(penalty)
        weights = weights - np.linalg.solve(curvature, gradient)
    return weights
