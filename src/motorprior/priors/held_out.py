"""Priors on held-out motors of a simulated fleet: adaptation, and the distribution of their samples."""

from collections.abc import Callable, Mapping

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.behaviour import behaviours
from motorprior.bench.bench_folder import BenchSettings
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import BENCH_PRESETS, record
from motorprior.evaluation.bench_truth import (
    HELD_OUT,
    HELD_OUT_SEED,
    MAX_WORK,
    ModelOfMotors,
    bench_coverage,
    bench_errors,
)
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.logs.motor_log import MotorLog
from motorprior.priors.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot

ADAPTED_SECONDS = 10.0  # log from which held-out motors are adapted for the fidelity table
POPULATION = 256
COMPARISONS = 5
# tags of random streams
_MOTORS = 29
_SAMPLES = 31
# classifier: bound on a standardised feature, against diverged motors; ridge penalty per training
# motor
_CLIP = 4.0
_RIDGE = 0.02
_FOLDS = 5
_REPEATS = 4
_NEWTON_STEPS = 8


def held_out_motors(bench: BenchSettings) -> TrueMotors:
    """As many other motors of the fleet as on the bench."""
    return bench.fleet.sample(
        bench.motors, np.random.default_rng([HELD_OUT_SEED, bench.seed, _MOTORS])
    )


def _held_out_log(
    robot: Robot, prior: MotorPrior, bench: BenchSettings, seconds: float
) -> MotorLog:
    """A bench log of the held-out motors at the prior's sample period, with a held-out excitation."""
    presets = (BENCH_PRESETS["adapt"], *BENCH_PRESETS.values())
    preset = next(preset for preset in presets if preset.period == prior.model.period).for_robot(
        robot
    )
    steps = round(seconds / preset.period)
    return record(held_out_motors(bench), preset, steps, HELD_OUT_SEED + bench.seed, bench.fleet)


def adapt_all(
    robot: Robot, priors: Mapping[str, MotorPrior], bench: BenchSettings
) -> dict[str, LatentPosterior]:
    """Every prior with latents, adapted to ADAPTED_SECONDS of log of the held-out motors."""
    return {
        name: adapt_to(prior, _held_out_log(robot, prior, bench, ADAPTED_SECONDS))
        for name, prior in priors.items()
        if prior.model.num_latents
    }


def adapted_models(
    priors: Mapping[str, MotorPrior], adapted: Mapping[str, LatentPosterior], num_motors: int
) -> dict[str, ModelOfMotors]:
    """Every prior as a model of held-out motors, at its posterior mean if it has latents."""
    models: dict[str, ModelOfMotors] = {}
    for name, prior in priors.items():
        z = adapted[name].mean if name in adapted else np.zeros((num_motors, 0))
        models[name] = lambda index, prior=prior, z=z: prior.model.motors(z[index])
    return models


def adaptation(
    robot: Robot,
    prior: MotorPrior,
    bench: BenchSettings,
    seconds: tuple[float, ...],
    adapted: LatentPosterior,
    seed: int,
    progress: Callable[[], None],
) -> Results:
    """Errors of a prior with physics that is adapted to held-out motors, and coverage of its bands.

    ``seconds`` are lengths of log [s], ``adapted`` is the prior adapted to ADAPTED_SECONDS of log,
    ``seed`` that of the held-out excitation, and ``progress`` is called after every length.

    Returns:
        For each length ``adapt_rmse_ratio``: median closed-loop RMSE on gait + impacts over that of
        the training motors; ``adapt_false_alarms``: share of held-out motors whose p-value is below
        FALSE_ALARMS; and the `bench_coverage` for the longest up to ADAPTED_SECONDS.
    """
    preset = HELD_OUT.for_robot(robot)
    train = bench_errors(bench.physical_motors(), {"prior": prior.training_motors}, seed, preset)[
        "impacts"
    ]["prior"]
    motors = held_out_motors(bench)
    results = Results()
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = _held_out_log(robot, prior, bench, length)
        found = adapted if length == ADAPTED_SECONDS else adapt_to(prior, log)
        p_value = outlier_test(prior, log, found)[0]
        model = adapted_models({"prior": prior}, {"prior": found}, len(motors))
        error = bench_errors(motors, model, seed, preset)["impacts"]["prior"]
        measured = {
            "adapt_rmse_ratio": np.median(error) / np.median(train),
            "adapt_false_alarms": np.mean(p_value < FALSE_ALARMS),
        }
        results += Results(
            Result(quantity, "1", float(value), motors="held_out", seconds=length)
            for quantity, value in measured.items()
        )
        if length == covered:
            results += bench_coverage(prior, found, motors, seed, preset)
        progress()
    return results


def distribution(prior: MotorPrior, bench: BenchSettings) -> Results:
    """POPULATION samples of the prior against as many held-out physical motors, by their behaviour on a bench.

    Repeated COMPARISONS times with other samples, since an AUC of 256 against 256 varies by some
    hundredths.

    Returns:
        ``two_sample_auc`` (0.5 is ideal), median with minimum and maximum; and
        ``aggregate_posterior_kl``, of the training motors' posteriors to N(0, I) [nat].
    """
    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, _SAMPLES])
    areas = []
    for _ in range(COMPARISONS):
        drawn = behaviours(prior.sample(POPULATION, rng))
        physical = behaviours(bench.fleet.sample(POPULATION, rng).after(MAX_WORK / 2).actuator())
        areas.append(two_sample_auc(drawn, physical, bench.seed))
    return Results(
        [
            Result("two_sample_auc", "1", float(np.median(areas)), statistic="median"),
            Result("two_sample_auc", "1", min(areas), statistic="low"),
            Result("two_sample_auc", "1", max(areas), statistic="high"),
            Result(
                "aggregate_posterior_kl", "nat", prior.metrics.get("aggregate_posterior_kl", 0.0)
            ),
        ]
    )


def standardise(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both samples (n, F) and (m, F) by their pooled median and interquartile range: x' = (x - median) / (IQR / 1.349).

    If the interquartile range is 0, the standard deviation is used, or 1 if that is 0 as well.
    """
    pooled = np.concatenate([a, b])
    low, middle, high = np.quantile(pooled, [0.25, 0.5, 0.75], axis=0)
    deviation = pooled.std(axis=0)
    spread = np.where(high > low, (high - low) / 1.349, np.where(deviation > 0, deviation, 1.0))
    return (a - middle) / spread, (b - middle) / spread


def two_sample_auc(a: np.ndarray, b: np.ndarray, seed: int) -> float:
    """Area under the ROC curve of a classifier that separates motors of ``a`` (n, F) from those of ``b`` (m, F) [-].

    0.5: inseparable; 1: always separable (Lopez-Paz & Oquab, Revisiting Classifier Two-Sample
    Tests, ICLR 2017). The classifier is a ridge logistic regression on the standardised features,
    their squares and pairwise products, which detects differences in location, scale and
    correlation. The result is the mean AUC of the held-out motors over stratified cross-validation
    folds and repeats. For equal distributions its standard deviation around 0.5 is 1.0 to 1.4 times
    √((n + m + 1) / (12·n·m)), that of a fixed score (Mann & Whitney 1947).
    """
    features = _quadratic(np.clip(np.concatenate(standardise(a, b)), -_CLIP, _CLIP))
    labels = np.arange(len(a) + len(b)) < len(a)
    rng = np.random.default_rng(seed)
    areas = []
    for _ in range(_REPEATS):
        fold = np.concatenate(
            [rng.permutation(np.arange(count) % _FOLDS) for count in (len(a), len(b))]
        )
        for held_out in range(_FOLDS):
            test = fold == held_out
            weights = _fit_logistic(features[~test], labels[~test])
            areas.append(
                area_under_curve(
                    features[test & labels] @ weights, features[test & ~labels] @ weights
                )
            )
    return float(np.mean(areas))


def area_under_curve(positive: np.ndarray, negative: np.ndarray) -> float:
    """Area under the ROC curve, P(score of a positive > score of a negative) + P(equal)/2 [-]."""
    from scipy.stats import mannwhitneyu  # here: it takes half a second to import

    pairs = mannwhitneyu(positive, negative, method="asymptotic").statistic
    return float(pairs / (len(positive) * len(negative)))


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
        curvature = (features.T * (share * probability * (1.0 - probability))) @ features + np.diag(
            penalty
        )
        weights = weights - np.linalg.solve(curvature, gradient)
    return weights
