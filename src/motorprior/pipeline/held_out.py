"""Fidelity on motors nobody trained on, how fast a prior adapts to them, and whether its draws are like them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.artifacts import atomic_path
from motorprior.bench.behaviour import behaviours
from motorprior.bench.facts import BenchFacts
from motorprior.bench.record import bench_preset, preset_of_period, record
from motorprior.identification.adapt import Posterior
from motorprior.identification.validate import HELD_OUT, HELD_OUT_SEED, ModelOfMotors, bench_errors
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import FALSE_ALARMS, adapt_to, judge
from motorprior.robots.robot import Robot

HELD_OUT_MOTORS, PRIOR_DRAWS = 29, 31
"""Tags of random streams."""
ADAPTED_SECONDS = 10.0
"""Log from which held-out motors are known in the fidelity table [s]."""
UNLIKELY = 0.1
"""Chance of being as odd that at most one motor of the fleet in ten should fall below."""
POPULATION, COMPARISONS = 256, 5
_WHERE = "held-out log"


def held_out_motors(facts: BenchFacts) -> MotorParameters:
    """As many motors of the same fleet as stood on the bench, but others."""
    return facts.fleet.sample(facts.motors, np.random.default_rng([HELD_OUT_SEED, facts.seed, HELD_OUT_MOTORS]))


def held_out_log(
    robot: Robot, prior: MotorPrior, motors: MotorParameters, facts: BenchFacts, seconds: float
) -> MotorLog:
    """A bench log of these motors at the prior's clock, with an excitation nobody trained on."""
    preset = preset_of_period(prior.network.period)
    preset = bench_preset("adapt") if preset.period == bench_preset("adapt").period else preset
    preset = preset.for_robot(robot)
    return record(motors, preset, round(seconds / preset.period), HELD_OUT_SEED + facts.seed, facts.fleet)


def adapt_all(
    robot: Robot, priors: dict[str, MotorPrior], paths: dict[str, Path], motors: MotorParameters, facts: BenchFacts
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


def adaptation_figures(
    robot: Robot,
    prior: MotorPrior,
    path: Path,
    facts: BenchFacts,
    seconds: tuple[float, ...],
    known: Posterior,
    seed: int,
    progress: Callable[[], None],
) -> dict[str, float]:
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
        ``adapt_rmse_ratio/S``: median closed-loop RMSE on gait + impacts after S seconds of log, over the training
        motors' own; ``adapt_false_alarms/S``: share of held-out motors called unlike the fleet, FALSE_ALARMS being
        stated, and ``adapt_unlikely/S``, share of those below UNLIKELY, which so few motors tell better; and, for the
        longest S up to ADAPTED_SECONDS, ``coverage50`` and ``coverage90``.
    """
    from motorprior.identification.coverage import coverage

    preset = HELD_OUT.for_robot(robot)
    train = bench_errors(facts.physical_motors(), {"prior": prior.training_motors}, seed, preset)["impacts"]["prior"]
    motors, figures = held_out_motors(facts), {}
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = held_out_log(robot, prior, motors, facts, length)
        found = known if length == ADAPTED_SECONDS else adapt_to(prior, path, log, _WHERE)
        chance = judge(prior, path, log, _WHERE, found).chance
        model: ModelOfMotors = lambda index, z=found.mean: LatentActuator(prior.network, z[index])  # noqa: E731
        error = bench_errors(motors, {"prior": model}, seed, preset)["impacts"]["prior"]
        figures[f"adapt_rmse_ratio/{length:g}"] = float(np.median(error) / np.median(train))
        figures[f"adapt_false_alarms/{length:g}"] = float(np.mean(chance < FALSE_ALARMS))
        figures[f"adapt_unlikely/{length:g}"] = float(np.mean(chance < UNLIKELY))
        if length == covered:
            figures |= coverage(prior.network, prior.metrics, found, motors, seed, preset)
        progress()
    return figures


def distribution_figures(prior: MotorPrior, facts: BenchFacts, picture: Path) -> dict[str, float]:
    """POPULATION draws of the prior against as many held-out physical motors, by their behaviour on a bench.

    COMPARISONS times, with other draws and other motors: an AUC of 256 against 256 scatters by some hundredths. Writes
    the quantiles of every feature of the first as a PNG.

    Returns:
        ``two_sample_auc`` (0.5 is perfect), ``energy_distance`` (0 is perfect), medians, the former also
        ``two_sample_auc/low`` and ``/high``, the extremes; of the first comparison ``energy_p_value`` and per feature F
        ``behaviour_auc/F`` (0.5 is perfect, above it the prior's values are larger); and ``aggregate_posterior_kl``,
        of the training motors' posteriors to N(0, I) [nat].
    """
    from motorprior.identification import distribution
    from motorprior.report.plots_distribution import feature_quantiles
    from motorprior.report.plots_style import png_bytes

    rng = np.random.default_rng([HELD_OUT_SEED, facts.seed, PRIOR_DRAWS])
    pairs = []
    for _ in range(COMPARISONS):
        drawn = behaviours(prior.sample(POPULATION, rng))
        pairs.append((drawn, behaviours(PhysicalActuator(facts.fleet.sample(POPULATION, rng)))))
    drawn, physical = pairs[0]
    shown = feature_quantiles(
        drawn.names, drawn.units, drawn.values, physical.values, "draws of the prior", "held-out physical motors"
    )
    with atomic_path(picture) as temporary:
        temporary.write_bytes(png_bytes(shown))
    one, other = drawn.values, physical.values
    areas = [distribution.two_sample_auc(a.values, b.values, facts.seed) for a, b in pairs]
    figures = {
        "two_sample_auc": float(np.median(areas)),
        "two_sample_auc/low": float(min(areas)),
        "two_sample_auc/high": float(max(areas)),
        "energy_distance": float(np.median([distribution.energy_distance(a.values, b.values) for a, b in pairs])),
        "energy_p_value": float(distribution.permutation_p_value(one, other, facts.seed)),
        "aggregate_posterior_kl": prior.metrics.get("aggregate_posterior_kl", 0.0),
    }
    separate = distribution.feature_auc(one, other)
    return figures | {f"behaviour_auc/{name}": float(value) for name, value in zip(drawn.names, separate, strict=True)}
