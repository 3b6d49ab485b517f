"""Closed-loop errors of learned models on out-of-family motors, whose equations the models lack.

    python benchmarks/out_of_family.py --out runs/out_of_family

For each out-of-family fleet: a bench, three models of its motors, and their errors on held-out
excitation for the motors of the bench (train) and for new motors of the fleet after adaptation to
10 s of log (new), as in `fidelity.py`. References are ``floor``, the true motors with an initial
error of 4 mrad; ``floor_warmth``, the true motors after 10 s of operation, regardless of their
actual warmth; ``tuned_pd``, one PD for all motors. figures.json contains medians over motors [rad]
as FAMILY/EXCITATION/MODEL/SET, and for samples of the rollout prior FAMILY/coverage90 and
FAMILY/two_sample_auc. Finished stages are reused.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import fidelity
from figures import PROGRESS, run_benchmark
from fleet_validation import validate_on_bench
from motorprior.actuator.families import TrueMotors
from motorprior.bench.bench_folder import read_bench
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from virtual_fleets.held_out_motors import ADAPTED_SECONDS, POPULATION, held_out_motors
from virtual_fleets.held_out_trials import HELD_OUT, MAX_WORK, bench_errors

PRESETS = ("rollout", "per_motor", "latent_network")
EXCITATIONS = {
    "gait": "bench_gait_rmse",
    "impacts": "bench_impact_rmse",
    "chirp": "bench_chirp_rmse",
}


@dataclass(frozen=True)
class Settings:
    """Identify the motors of every fleet and measure the errors of the models."""

    out: Path  # run folder
    motors: int = 32  # motors on the bench
    steps: int = 10_000  # samples per motor
    adam_steps: int | None = None  # Adam steps of every network; the preset's number if not given
    seed: int = 0  # seed of bench, training and held-out excitation
    families: tuple[str, ...] = ("foreign_direct", "foreign_servo")  # fleets
    presets: tuple[str, ...] = PRESETS  # presets of the priors
    population: int = POPULATION  # samples of the rollout prior for the two-sample test


def measured_family(settings: Settings, family: str) -> dict[str, float]:
    """Errors [rad] on both sets of motors; coverage and AUC of samples of the rollout prior."""
    folder = settings.out / family
    of_fleet = fidelity.Settings(
        folder, family, settings.motors, settings.steps, settings.adam_steps, settings.seed
    )
    priors = [fidelity.identify(of_fleet, preset) for preset in settings.presets]
    results = validate_on_bench(
        priors,
        folder / "validate",
        seed=settings.seed,
        adapt_seconds=(ADAPTED_SECONDS,),
        population=settings.population,
        progress=PROGRESS,
    )

    bench = read_bench(folder / "bench" / "rollout")[1]
    figures: dict[str, float] = {}
    figures |= _errors(settings, results, "train", family, "train", bench.physical_motors())
    figures |= _errors(settings, results, "held_out", family, "new", held_out_motors(bench))
    figures[f"{family}/coverage90"] = results.value(quantity="coverage90", part=None)
    auc = results.value(quantity="two_sample_auc", statistic="median")
    figures[f"{family}/two_sample_auc"] = auc
    return figures


def _errors(
    settings: Settings,
    results: Results,
    motor_set: str,
    family: str,
    name: str,
    motors: TrueMotors,
) -> dict[str, float]:
    """Median errors [rad] of the models and of both floors on a set of motors.

    ``motor_set`` is its name in the results, ``name`` its name in the figures.
    """
    half_warm = motors.after(MAX_WORK / 2)
    models = {"floor_warmth": lambda index: half_warm.take(index).actuator()}
    schedule = HELD_OUT.for_robot(load_robot(DEFAULT_ROBOT))
    errors_of_warmth = bench_errors(motors, models, settings.seed, schedule)

    medians = results.where(motors=motor_set, statistic="median")
    figures = {}
    for excitation, quantity in EXCITATIONS.items():
        prefix = f"{family}/{excitation}"
        for model in (*settings.presets, "tuned_pd"):
            error = medians.value(quantity=quantity, model=model)
            figures[f"{prefix}/{model}/{name}"] = error
        floor = medians.value(quantity=quantity, model="physical")
        figures[f"{prefix}/floor/{name}"] = floor
        warmth = np.median(errors_of_warmth[excitation]["floor_warmth"])
        figures[f"{prefix}/floor_warmth/{name}"] = float(warmth)
    return figures


def measure(settings: Settings) -> dict[str, float]:
    """The figures of all families."""
    figures = {}
    for family in settings.families:
        figures |= measured_family(settings, family)
    return figures


if __name__ == "__main__":
    run_benchmark(Settings, measure, __doc__)
