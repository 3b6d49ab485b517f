"""Fidelity on held-out motors, how fast a prior adapts to them, and whether its draws are like them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import atomic_path
from motorprior.bench.behaviour import behaviours
from motorprior.bench.bench_folder import BenchSettings
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import bench_preset, preset_of_period, record
from motorprior.identification.evaluation.bench_fidelity import (
    HELD_OUT,
    HELD_OUT_SEED,
    MAX_WORK,
    ModelOfMotors,
    bench_errors,
)
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot

HELD_OUT_MOTORS, PRIOR_DRAWS = 29, 31
"""Tags of random streams."""
ADAPTED_SECONDS = 10.0
"""Log from which held-out motors are known in the fidelity table [s]."""
UNLIKELY = 0.1
"""p value of `outlier_test` below which a held-out motor counts in ``adapt_unlikely``; at most one motor in ten of the
fleet itself should be below."""
POPULATION, COMPARISONS = 256, 5
_WHERE = "held-out log"


def held_out_motors(facts: BenchSettings) -> TrueMotors:
    """As many motors of the same fleet as stood on the bench, but others."""
    return facts.fleet.sample(facts.motors, np.random.default_rng([HELD_OUT_SEED, facts.seed, HELD_OUT_MOTORS]))


def held_out_log(robot: Robot, prior: MotorPrior, motors: TrueMotors, facts: BenchSettings, seconds: float) -> MotorLog:
    """A bench log of these motors at the prior's clock, with a held-out excitation."""
    preset = preset_of_period(prior.network.period)
    preset = bench_preset("adapt") if preset.period == bench_preset("adapt").period else preset
    preset = preset.for_robot(robot)
    return record(motors, preset, round(seconds / preset.period), HELD_OUT_SEED + facts.seed, facts.fleet)


def adapt_all(
    robot: Robot, priors: dict[str, MotorPrior], paths: dict[str, Path], motors: TrueMotors, facts: BenchSettings
) -> dict[str, Posterior]:
    """Every prior with latents, adapted to ADAPTED_SECONDS of log of held-out motors."""
    return {
        name: adapt_to(prior, paths[name], held_out_log(robot, prior, motors, facts, ADAPTED_SECONDS), _WHERE)
        for name, prior in priors.items()
        if prior.network.num_latents
    }


def adapted_models(
    priors: dict[str, MotorPrior], known: dict[str, Posterior], num_motors: int
) -> dict[str, ModelOfMotors]:
    """Every prior as a model of held-out motors: at the mean of what is ``known`` of them, if it has latents."""
    models: dict[str, ModelOfMotors] = {}
    for name, prior in priors.items():
        z = known[name].mean if name in known else np.zeros((num_motors, 0))
        models[name] = lambda index, prior=prior, z=z: LatentActuator(prior.network, z[index])
    return models


def adaptation(
    robot: Robot,
    prior: MotorPrior,
    path: Path,
    facts: BenchSettings,
    seconds: tuple[float, ...],
    known: Posterior,
    seed: int,
    progress: Callable[[], None],
) -> Results:
    """How close held-out motors come to the training motors' error, and what the bands promise.

    Args:
        robot: whose motors they are.
        prior: of preset rollout.
        path: its file.
        facts: of its bench.
        seconds: lengths of log.
        known: the prior adapted to ADAPTED_SECONDS of log.
        seed: of the held-out excitation.
        progress: called after every length.

    Returns:
        For each length ``adapt_rmse_ratio``: median closed-loop RMSE on gait + impacts over the training motors' own;
        ``adapt_false_alarms``: share of held-out motors called unlike the fleet, FALSE_ALARMS being stated, and
        ``adapt_unlikely``, share of those below UNLIKELY, which so few motors tell better; and, for the longest up to
        ADAPTED_SECONDS, the `coverage`.
    """
    from motorprior.identification.evaluation.coverage import coverage

    preset = HELD_OUT.for_robot(robot)
    train = bench_errors(facts.physical_motors(), {"prior": prior.training_motors}, seed, preset)["impacts"]["prior"]
    motors, results = held_out_motors(facts), Results()
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = held_out_log(robot, prior, motors, facts, length)
        found = known if length == ADAPTED_SECONDS else adapt_to(prior, path, log, _WHERE)
        p_value = outlier_test(prior, path, log, _WHERE, found).p_value
        model: ModelOfMotors = lambda index, z=found.mean: LatentActuator(prior.network, z[index])  # noqa: E731
        error = bench_errors(motors, {"prior": model}, seed, preset)["impacts"]["prior"]
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


def distribution(prior: MotorPrior, facts: BenchSettings, picture: Path) -> Results:
    """POPULATION draws of the prior against as many held-out physical motors, by their behaviour on a bench.

    COMPARISONS times, with other draws and other motors: an AUC of 256 against 256 scatters by some hundredths. Writes
    the quantiles of every feature of the first as a PNG.

    Returns:
        ``two_sample_auc`` (0.5 is perfect), ``energy_distance`` (0 is perfect), medians, of the former also the lowest
        and the highest; of the first comparison ``energy_p_value`` and per feature ``behaviour_auc`` (0.5 is perfect,
        above it the prior's values are larger); and ``aggregate_posterior_kl``, of the training motors' posteriors to
        N(0, I) [nat].
    """
    from motorprior.identification.evaluation.distribution import (
        energy_distance,
        feature_auc,
        permutation_p_value,
        two_sample_auc,
    )
    from motorprior.report.plots_prior import feature_quantiles
    from motorprior.report.plots_style import png_bytes

    rng = np.random.default_rng([HELD_OUT_SEED, facts.seed, PRIOR_DRAWS])
    pairs = []
    for _ in range(COMPARISONS):
        drawn = behaviours(prior.sample(POPULATION, rng))
        true = facts.fleet.sample(POPULATION, rng).after(MAX_WORK / 2)
        pairs.append((drawn, behaviours(true.actuator())))
    drawn, physical = pairs[0]
    shown = feature_quantiles(
        drawn.names, drawn.units, drawn.values, physical.values, "draws of the prior", "held-out physical motors"
    )
    with atomic_path(picture) as temporary:
        temporary.write_bytes(png_bytes(shown))
    one, other = drawn.values, physical.values
    areas = [two_sample_auc(a.values, b.values, facts.seed) for a, b in pairs]
    distance = np.median([energy_distance(a.values, b.values) for a, b in pairs])
    kl = prior.metrics.get("aggregate_posterior_kl", 0.0)
    rows = [
        Result("two_sample_auc", "1", float(np.median(areas)), statistic="median"),
        Result("two_sample_auc", "1", float(min(areas)), statistic="low"),
        Result("two_sample_auc", "1", float(max(areas)), statistic="high"),
        Result("energy_distance", "1", float(distance), statistic="median"),
        Result("energy_p_value", "1", float(permutation_p_value(one, other, facts.seed))),
        Result("aggregate_posterior_kl", "nat", kl),
    ]
    separate = zip(drawn.names, feature_auc(one, other), strict=True)
    rows += [Result("behaviour_auc", "1", float(value), part=name) for name, value in separate]
    return Results.of(rows)
