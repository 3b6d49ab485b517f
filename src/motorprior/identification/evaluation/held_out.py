"""A prior on held-out motors of a simulated fleet: errors after adaptation, and the distribution of its samples."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.behaviour import Behaviours, behaviours
from motorprior.bench.bench_folder import BenchSettings
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import bench_preset, preset_of_period, record
from motorprior.identification.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.identification.evaluation.bench_fidelity import (
    HELD_OUT,
    HELD_OUT_SEED,
    MAX_WORK,
    ModelOfMotors,
    bench_errors,
)
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.logs.motor_log import MotorLog
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot

HELD_OUT_MOTORS, PRIOR_SAMPLES = 29, 31  # tags of random streams
ADAPTED_SECONDS = 10.0  # log from which held-out motors are adapted for the fidelity table
UNLIKELY = 0.1  # p-value of `outlier_test` below which a held-out motor counts in ``adapt_unlikely``
POPULATION, COMPARISONS = 256, 5


def held_out_motors(bench: BenchSettings) -> TrueMotors:
    """As many other motors of the fleet as on the bench."""
    return bench.fleet.sample(bench.motors, np.random.default_rng([HELD_OUT_SEED, bench.seed, HELD_OUT_MOTORS]))


def held_out_log(robot: Robot, prior: MotorPrior, motors: TrueMotors, bench: BenchSettings, seconds: float) -> MotorLog:
    """A bench log of these motors at the prior's sample period, with a held-out excitation."""
    preset = preset_of_period(prior.network.period)
    preset = bench_preset("adapt") if preset.period == bench_preset("adapt").period else preset
    preset = preset.for_robot(robot)
    return record(motors, preset, round(seconds / preset.period), HELD_OUT_SEED + bench.seed, bench.fleet)


def adapt_all(
    robot: Robot, priors: dict[str, MotorPrior], paths: dict[str, Path], motors: TrueMotors, bench: BenchSettings
) -> dict[str, Posterior]:
    """Every prior with latents, adapted to ADAPTED_SECONDS of log of held-out motors."""
    return {
        name: adapt_to(prior, paths[name], held_out_log(robot, prior, motors, bench, ADAPTED_SECONDS), "held-out log")
        for name, prior in priors.items()
        if prior.network.num_latents
    }


def adapted_models(
    priors: dict[str, MotorPrior], adapted: dict[str, Posterior], num_motors: int
) -> dict[str, ModelOfMotors]:
    """Every prior as a model of held-out motors, at its posterior mean if it has latents."""
    models: dict[str, ModelOfMotors] = {}
    for name, prior in priors.items():
        z = adapted[name].mean if name in adapted else np.zeros((num_motors, 0))
        models[name] = lambda index, prior=prior, z=z: LatentActuator(prior.network, z[index])
    return models


def adaptation(
    robot: Robot,
    prior: MotorPrior,
    path: Path,
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
        path: its file.
        bench: of its bench.
        seconds: lengths of log [s].
        adapted: the prior adapted to ADAPTED_SECONDS of log.
        seed: of the held-out excitation.
        progress: called after every length.

    Returns:
        For each length ``adapt_rmse_ratio``: median closed-loop RMSE on gait + impacts over that of the training
        motors; ``adapt_false_alarms`` and ``adapt_unlikely``: share of held-out motors whose p-value is below
        FALSE_ALARMS and UNLIKELY; and the `coverage` for the longest up to ADAPTED_SECONDS.
    """
    from motorprior.identification.evaluation.coverage import coverage

    preset = HELD_OUT.for_robot(robot)
    train = bench_errors(bench.physical_motors(), {"prior": prior.training_motors}, seed, preset)["impacts"]["prior"]
    motors, results = held_out_motors(bench), Results()
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = held_out_log(robot, prior, motors, bench, length)
        found = adapted if length == ADAPTED_SECONDS else adapt_to(prior, path, log, "held-out log")
        p_value = outlier_test(prior, path, log, "held-out log", found).p_value
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
            results += coverage(prior.network, prior.metrics, found, motors, seed, preset)
        progress()
    return results


def distribution(prior: MotorPrior, bench: BenchSettings) -> tuple[Results, Behaviours, Behaviours]:
    """POPULATION samples of the prior against as many held-out physical motors, by their behaviour on a bench.

    Repeated COMPARISONS times with other samples, since an AUC of 256 against 256 varies by some hundredths.


    Returns:
        ``two_sample_auc`` (0.5 is ideal) with minimum and maximum, and ``energy_distance`` (0 is ideal), medians; of
        the first comparison ``energy_p_value`` and per feature ``behaviour_auc`` (0.5 is ideal, above it the prior's
        values are larger); and ``aggregate_posterior_kl``, of the training motors' posteriors to N(0, I) [nat]. Then
        the behaviours of the first samples of the prior and of the first physical motors.
    """
    from motorprior.identification.evaluation.distribution import (
        energy_distance,
        feature_auc,
        permutation_p_value,
        two_sample_auc,
    )

    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, PRIOR_SAMPLES])
    pairs = []
    for _ in range(COMPARISONS):
        drawn = behaviours(prior.sample(POPULATION, rng))
        true = bench.fleet.sample(POPULATION, rng).after(MAX_WORK / 2)
        pairs.append((drawn, behaviours(true.actuator())))
    drawn, physical = pairs[0]
    one, other = drawn.values, physical.values
    areas = [two_sample_auc(a.values, b.values, bench.seed) for a, b in pairs]
    distance = np.median([energy_distance(a.values, b.values) for a, b in pairs])
    rows = [
        Result("two_sample_auc", "1", float(function(areas)), statistic=statistic)
        for statistic, function in (("median", np.median), ("low", min), ("high", max))
    ]
    rows += [
        Result("energy_distance", "1", float(distance), statistic="median"),
        Result("energy_p_value", "1", float(permutation_p_value(one, other, bench.seed))),
        Result("aggregate_posterior_kl", "nat", prior.metrics.get("aggregate_posterior_kl", 0.0)),
    ]
    separate = zip(drawn.names, feature_auc(one, other), strict=True)
    rows += [Result("behaviour_auc", "1", float(value), part=name) for name, value in separate]
    return Results.of(rows), drawn, physical
