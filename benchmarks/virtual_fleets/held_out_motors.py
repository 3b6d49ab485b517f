"""Priors on held-out motors of a virtual fleet: adaptation, and distribution of their samples."""

from collections.abc import Callable, Mapping

import numpy as np

from motorprior.actuator.families import TrueMotors
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import BenchSettings
from motorprior.bench.recording import BENCH_SCHEDULES, record
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.logs.motor_log import MotorLog
from motorprior.priors.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from virtual_fleets.behaviour import behaviours
from virtual_fleets.held_out_trials import (
    HELD_OUT,
    HELD_OUT_SEED,
    MAX_WORK,
    ModelOfMotors,
    bench_coverage,
    bench_errors,
)
from virtual_fleets.two_sample import two_sample_auc

ADAPTED_SECONDS = 10.0  # log from which held-out motors are adapted for the fidelity table [s]
POPULATION = 256  # samples of a prior, and motors of the fleet, that a classifier separates
COMPARISONS = 5
# tags of random streams
_MOTORS = 29
_SAMPLES = 31


def held_out_motors(bench: BenchSettings) -> TrueMotors:
    """As many other motors of the fleet as on the bench."""
    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, _MOTORS])
    return bench.fleet.sample(bench.motors, rng)


def _held_out_log(
    robot: Robot, prior: MotorPrior, bench: BenchSettings, seconds: float
) -> MotorLog:
    """A bench log of the held-out motors at the prior's sample period.

    Its excitation is held out, too.
    """
    schedules = (BENCH_SCHEDULES["adapt"], *BENCH_SCHEDULES.values())
    period = prior.model.period
    schedule = next(schedule for schedule in schedules if schedule.period == period)
    schedule = schedule.for_robot(robot)
    steps = round(seconds / schedule.period)
    return record(held_out_motors(bench), schedule, steps, HELD_OUT_SEED + bench.seed, bench.fleet)


def adapt_all(
    robot: Robot, priors: Mapping[str, MotorPrior], bench: BenchSettings
) -> dict[str, LatentPosterior]:
    """Every prior with latents, adapted to ADAPTED_SECONDS of log of the held-out motors."""
    posteriors = {}
    for name, prior in priors.items():
        if prior.model.num_latents:
            log = _held_out_log(robot, prior, bench, ADAPTED_SECONDS)
            posteriors[name] = adapt_to(prior, log)
    return posteriors


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

    Args:
        robot: scales the loads of the bench.
        prior: with physics.
        bench: of the prior's training motors.
        seconds: lengths of log [s] to adapt to.
        adapted: the prior adapted to ADAPTED_SECONDS of log.
        seed: of the held-out excitation.
        progress: called after every length.

    Returns:
        For each length ``adapt_rmse_ratio``: median closed-loop RMSE on gait + impacts over that of
        the training motors; ``adapt_false_alarms``: share of held-out motors whose p-value is below
        FALSE_ALARMS; and the `bench_coverage` for the longest up to ADAPTED_SECONDS.
    """
    schedule = HELD_OUT.for_robot(robot)
    of_training = {"prior": prior.training_motors}
    errors = bench_errors(bench.physical_motors(), of_training, seed, schedule)
    training_error = errors["impacts"]["prior"]

    motors = held_out_motors(bench)
    results = Results()
    covered = max((length for length in seconds if length <= ADAPTED_SECONDS), default=None)
    for length in sorted(seconds):
        log = _held_out_log(robot, prior, bench, length)
        posterior = adapted if length == ADAPTED_SECONDS else adapt_to(prior, log)
        p_value = outlier_test(prior, log, posterior)[0]

        model = adapted_models({"prior": prior}, {"prior": posterior}, len(motors))
        error = bench_errors(motors, model, seed, schedule)["impacts"]["prior"]
        measured = {
            "adapt_rmse_ratio": np.median(error) / np.median(training_error),
            "adapt_false_alarms": np.mean(p_value < FALSE_ALARMS),
        }
        results += Results(
            Result(quantity, "1", float(value), motors="held_out", seconds=length)
            for quantity, value in measured.items()
        )
        if length == covered:
            results += bench_coverage(prior, posterior, motors, seed, schedule)
        progress()
    return results


def distribution(prior: MotorPrior, bench: BenchSettings, population: int = POPULATION) -> Results:
    """Samples of the prior against as many held-out motors, by their behaviour.

    ``population`` is the number of samples.

    Repeated COMPARISONS times with other samples, since an AUC of 256 against 256 varies by some
    hundredths.

    Returns:
        ``two_sample_auc`` (0.5 is ideal), median with minimum and maximum; and
        ``aggregate_posterior_kl``, of the training motors' posteriors to N(0, I) [nat].
    """
    rng = np.random.default_rng([HELD_OUT_SEED, bench.seed, _SAMPLES])
    areas = []
    for _ in range(COMPARISONS):
        sampled = behaviours(prior.sample(population, rng))
        motors = bench.fleet.sample(population, rng)
        physical = behaviours(motors.after(MAX_WORK / 2).actuator())
        areas.append(two_sample_auc(sampled, physical, bench.seed))

    divergence = prior.metrics.aggregate_posterior_kl or 0.0
    return Results(
        [
            Result("two_sample_auc", "1", float(np.median(areas)), statistic="median"),
            Result("two_sample_auc", "1", min(areas), statistic="low"),
            Result("two_sample_auc", "1", max(areas), statistic="high"),
            Result("aggregate_posterior_kl", "nat", divergence),
        ]
    )
