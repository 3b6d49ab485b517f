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
from motorprior.bench.bench_folder import read_bench
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from virtual_fleets.held_out_motors import ADAPTED_SECONDS, held_out_motors
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


def measured_family(settings: Settings, family: str) -> dict[str, float]:
    """Errors [rad] on both sets of motors; coverage and AUC of samples of the rollout prior."""
    folder = settings.out / family
    seed = settings.seed
    own = fidelity.Settings(
        folder, family, settings.motors, settings.steps, settings.adam_steps, seed
    )
    priors = [fidelity.identify(own, preset) for preset in PRESETS]
    lengths = (ADAPTED_SECONDS,)
    out = folder / "validate"
    results = validate_on_bench(priors, out, seed=seed, adapt_seconds=lengths, progress=PROGRESS)
    bench = read_bench(folder / "bench" / "rollout")[1]
    figures: dict[str, float] = {}
    for each, motors in (("train", bench.physical_motors()), ("new", held_out_motors(bench))):
        half_warm = motors.after(MAX_WORK / 2)
        models = {"floor_warmth": lambda index, known=half_warm: known.take(index).actuator()}
        warmth = bench_errors(motors, models, seed, HELD_OUT.for_robot(load_robot(DEFAULT_ROBOT)))
        here = results.where(motors="train" if each == "train" else "held_out", statistic="median")
        for kind, quantity in EXCITATIONS.items():
            for model in (*PRESETS, "tuned_pd", "physical"):
                key = f"{family}/{kind}/{'floor' if model == 'physical' else model}/{each}"
                figures[key] = here.value(quantity=quantity, model=model)
            figures[f"{family}/{kind}/floor_warmth/{each}"] = float(
                np.median(warmth[kind]["floor_warmth"])
            )
    figures[f"{family}/coverage90"] = results.value(quantity="coverage90", part=None)
    figures[f"{family}/two_sample_auc"] = results.value(
        quantity="two_sample_auc", statistic="median"
    )
    return figures


def measure(settings: Settings) -> dict[str, float]:
    """The figures of all families."""
    return {
        key: value
        for family in settings.families
        for key, value in measured_family(settings, family).items()
    }


if __name__ == "__main__":
    run_benchmark(Settings, measure, __doc__)
