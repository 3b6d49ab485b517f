"""Priors on held-out motors of a simulated fleet: adaptation, and the distribution of their samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.behaviour import Behaviours, behaviours
from motorprior.bench.bench_folder import BenchSettings
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import bench_preset, preset_of_period, record
from motorprior.identification.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.identification.evaluation.bench_truth import (
    HELD_OUT,
    HELD_OUT_SEED,
    MAX_WORK,
    ModelOfMotors,
    bench_errors,
)
from motorprior.logs.motor_log import MotorLog
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.latents.latent_fit import Posterior

ADAPTED_SECONDS = 10.0  # log from which held-out motors are adapted for the fidelity table
UNLIKELY = 0.1  # p-value of `outlier_test` below which a held-out motor counts in ``adapt_unlikely``
POPULATION, COMPARISONS = 256, 5
_MOTORS, _SAMPLES = 29, 31  # tags of random streams


def held_out_motors(bench: BenchSettings) -> TrueMotors:
    """As many other motors of the fleet as on the bench."""
    return bench.fleet.sample(bench.motors, np.random.default_rng([HELD_OUT_SEED, bench.seed, _MOTORS]))


def _held_out_log(robot: Robot, prior: MotorPrior, bench: BenchSettings, seconds: float) -> MotorLog:
    """A bench log of the held-out motors at the prior's sample period, with a held-out excitation."""
    preset = preset_of_period(prior.model.period)
    preset = bench_preset("adapt") if preset.period == bench_preset("adapt").period else preset
    preset = preset.for_robot(robot)
    return record(
        held_out_motors(bench), preset, round(seconds / preset.period), HELD_OUT_SEED + bench.seed, bench.fleet
    )


def adapt_all(robot: Robot, priors: Mapping[str, MotorPrior], bench: BenchSettings) -> dict[str, Posterior]:
    """Every prior with latents, adapted to ADAPTED_SECONDS of log of the held-out motors."""
    return {
        name: adapt_to(prior, _held_out_log(robot, prior, bench, ADAPTED_SECONDS))
        for name, prior in priors.items()
        if prior.model.num_latents
    }


def adapted_models(
    priors: Mapping[str, MotorPrior], adapted: Mapping[str, Posterior], num_motors: int
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
    adapted: Posterior,
    seed: int,
    progress: Callable[[], None],
) -> Results:
    """Errors of a prior adapted to held-out motors, and coverage of its bands.

    Args:
        robot: of the motors.
        prior: with physics.
        bench: of its bench.
        seconds: lengths of log [s].
        adapted: the prior adapted to ADAPTED_SECONDS of log.
        seed: of the held-out excitation.
        progress: called after every length.

    Returns:
        For each length ``adapt_rmse_ratio``: median closed-loop RMSE on gait + impacts over that of the training
        motors; ``adapt_false_alarms`` and ``adapt_unlikely``: share of held-out motors whose p-value is below
        FALSE_ALARMS and UNLIKELY; and the `bench_coverage` for the longest up to ADAPTED_SECONDS.
    """
    from motorprior.identification.evaluation.bands import bench_coverage  # here: it imports JAX

    preset = HELD_OUT.for_robot(robot)
    train = bench_errors(bench.physical_motors(), {"prior": prior.training_motors}, seed, preset)["impacts"]["prior"]
    motors, results = held_out_motors(bench), Results()
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = _held_out_log(robot, prior, bench, length)
        found = adapted if length == ADAPTED_SECONDS else adapt_to(prior, log)
        p_value = outlier_test(prior, log, found).p_value
        model = adapted_models({"prior": prior}, {"prior": found}, len(motors))
        error = bench_errors(motors, model, seed, preset)["impacts"]["prior"]
        measured = {
            "adapt_rmse_ratio": np.median(error) / np.median(train),
            "adapt_false_alarms": np.mean(p_value < FALSE_ALARMS),
            "adapt_unlikely": np.mean(p_value < UNLIKELY),
        }
        results += Results.of(
            Result(quantity, "1", float(value), motors="held_out", seconds=length)
            for quantity, value in measured.items()
        )
        if length == covered:
            results += bench_coverage(prior, found, motors, seed, preset)
        progress()
    return results


def distribution(prior: MotorPrior, bench: BenchSettings) -> Results:
    """POPULATION samples of the prior against as many held-out physical motors, by their behaviour on a bench.

    Repeated COMPARISONS times with other samples, since an AUC of 256 against 256 varies by some hundredths.

    Returns:
        ``two_sample_auc`` (0.5 is ideal) with minimum and maximum, and ``energy_distance`` (0 is ideal), medians; of
        the first comparison ``energy_p_value`` and per feature ``behaviour_auc`` (0.5 is ideal, above it the prior's
        values are larger); and ``aggregate_posterior_kl``, of the training motors' posteriors to N(0, I) [nat].
    """
    from motorprior.identification.evaluation import distribution as two_sample  # here: it imports scipy.stats

    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, _SAMPLES])
    pairs: list[tuple[Behaviours, Behaviours]] = []
    for _ in range(COMPARISONS):
        drawn = behaviours(prior.sample(POPULATION, rng))
        pairs.append((drawn, behaviours(bench.fleet.sample(POPULATION, rng).after(MAX_WORK / 2).actuator())))
    first, physical = pairs[0]
    areas = [two_sample.two_sample_auc(one.values, other.values, bench.seed) for one, other in pairs]
    distance = float(np.median([two_sample.energy_distance(one.values, other.values) for one, other in pairs]))
    p_value = two_sample.permutation_p_value(first.values, physical.values, bench.seed)
    return Results.of([
        Result("two_sample_auc", "1", float(np.median(areas)), statistic="median"),
        Result("two_sample_auc", "1", min(areas), statistic="low"),
        Result("two_sample_auc", "1", max(areas), statistic="high"),
        Result("energy_distance", "1", distance, statistic="median"),
        Result("energy_p_value", "1", p_value),
        Result("aggregate_posterior_kl", "nat", prior.metrics.get("aggregate_posterior_kl", 0.0)),
        *(
            Result("behaviour_auc", "1", float(value), part=name)
            for name, value in zip(first.names, two_sample.feature_auc(first.values, physical.values), strict=True)
        ),
    ])  # fmt: skip


def armature_results(motors: TrueMotors, priors: Mapping[str, MotorPrior]) -> Results:
    """Mean ratio of the decoded armature to that of the physical motors, and their correlation over the motors."""
    rows: list[Result] = []
    for name, prior in priors.items():
        if isinstance(prior.model, GreyBox) or prior.model.has_armature:
            decoded = prior.model.armature(prior.mean)
            rows.append(Result("armature_ratio", "1", float(np.mean(decoded / motors.armature)), name, "train"))
            if np.ptp(decoded) > 0 and np.ptp(motors.armature) > 0:
                correlation = float(np.corrcoef(decoded, motors.armature)[0, 1])
                rows.append(Result("armature_correlation", "1", correlation, name, "train"))
    return Results.of(rows)
