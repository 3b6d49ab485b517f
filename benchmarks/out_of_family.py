"""Closed-loop errors of learned models on out-of-family motors, whose equations the models lack.

    python benchmarks/out_of_family.py --out runs/out_of_family

For each out-of-family fleet: a bench, three models of its motors, and their errors on held-out excitation for the
motors of the bench (train) and for new motors of the fleet after adaptation to 10 s of log (new). References are
``floor``, the true motors with an initial error of 4 mrad; ``floor_warmth``, the true motors after 10 s of operation,
regardless of their actual warmth; ``tuned_pd``, one PD for all motors. figures.json contains medians over motors [rad]
as FAMILY/EXCITATION/MODEL/SET, and for samples of the rollout prior FAMILY/coverage90 and FAMILY/two_sample_auc.
Finished stages are reused.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from figures import markdown, measured
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_json, write_text
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.families import TrueMotors
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.evaluation.bench_truth import (
    HELD_OUT,
    MAX_WORK,
    ModelOfMotors,
    bench_coverage,
    bench_errors,
)
from motorprior.identification.baselines.pd_fit import RESTARTS, WITH_ROTOR, fit_pd
from motorprior.identification.presets import network_steps
from motorprior.priors.fit_prior import PRIOR
from motorprior.priors.held_out import adapt_all, adapted_models, distribution, held_out_motors
from motorprior.progress import Lines
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import FIGURES, description

PRESETS = ("rollout", "per_motor", "latent_network")
EXCITATIONS = ("gait", "impacts", "chirp")
SETS = ("train", "new")
MODELS = (*PRESETS, "tuned_pd", "floor_warmth", "floor")
PROGRESS = Lines(sys.stderr)


@dataclass(frozen=True)
class Settings:
    """Identify the motors of every fleet and measure the errors of the models."""

    out: Path  # run folder
    motors: int = 32  # motors on the bench
    steps: int = 10_000  # samples per motor
    adam_steps: int | None = None  # Adam steps of every network; the preset's number if not given
    seed: int = 0  # seed of bench, training and held-out excitation
    families: tuple[str, ...] = ("foreign_direct", "foreign_servo")  # fleets


def identify(settings: Settings, family: str) -> dict[str, Path]:
    """The priors of a fleet; recorded and trained if their files do not exist."""
    bench, priors = settings.out / family / "bench", settings.out / family / "priors"
    run_bench(Bench(bench, family, "rollout", settings.motors, settings.steps, settings.seed), PROGRESS)
    for preset in PRESETS:
        steps = network_steps(preset, settings.adam_steps)
        run_identify(Identify(bench, priors / preset, preset, settings.seed, steps), PROGRESS)
    return {preset: priors / preset / PRIOR for preset in PRESETS}


def measure(settings: Settings, family: str) -> dict[str, float]:
    """The figures of one fleet."""
    paths, folder = identify(settings, family), settings.out / family / "measured"
    wanted = description("validate", asdict(settings) | {"families": [family]}, list(paths.values()))
    return measured(folder, wanted, lambda: figures(settings, family, paths))


def figures(settings: Settings, family: str, paths: dict[str, Path]) -> dict[str, float]:
    """Errors [rad] on both sets of motors; coverage and AUC of samples of the rollout prior."""
    robot, priors = load_robot(DEFAULT_ROBOT), {name: MotorPrior.load(path) for name, path in paths.items()}
    bench = read_bench(settings.out / family / "bench")[1]
    pd = tuned_pd(settings, family)
    with PROGRESS.start(f"{family}: train, new, coverage, samples", 4) as task:
        train: dict[str, ModelOfMotors] = {name: prior.training_motors for name, prior in priors.items()}
        found = errors(settings, family, "train", bench.physical_motors(), train | pd)
        task.advance()
        new = held_out_motors(bench)
        known = adapt_all(robot, priors, bench)
        found |= errors(settings, family, "new", new, adapted_models(priors, known, len(new)) | pd)
        task.advance()
        prior, preset = priors["rollout"], HELD_OUT.for_robot(robot)
        covered = bench_coverage(prior, known["rollout"], new, settings.seed, preset)
        found[f"{family}/coverage90"] = covered.value(quantity="coverage90", part=None)
        task.advance()
        auc = distribution(prior, bench).value(quantity="two_sample_auc", statistic="median")
        found[f"{family}/two_sample_auc"] = auc
        task.advance()
    return found


def tuned_pd(settings: Settings, family: str) -> dict[str, ModelOfMotors]:
    """One PD for all motors, fitted to the bench log."""
    log = read_bench(settings.out / family / "bench")[0]
    with PROGRESS.start(f"{family}: tune the PD", RESTARTS) as task:
        tuned = fit_pd(log, WITH_ROTOR, report=task.advance).constants
    return {"tuned_pd": lambda index: IdealPd.uniform(len(index), **tuned)}


def errors(
    settings: Settings, family: str, which: str, motors: TrueMotors, models: dict[str, ModelOfMotors]
) -> dict[str, float]:
    """Median RMSE over motors [rad] of all models and both floors, by key in figures.json."""
    half_warm = motors.after(MAX_WORK / 2)
    floors: dict[str, ModelOfMotors] = {"floor_warmth": lambda index: half_warm.take(index).actuator()}
    found = bench_errors(motors, models | floors, settings.seed, HELD_OUT.for_robot(load_robot(DEFAULT_ROBOT)))
    return {
        f"{family}/{kind}/{'floor' if name == 'physical' else name}/{which}": float(np.median(values))
        for kind in EXCITATIONS
        for name, values in found[kind].items()
    }


def table(figures: dict[str, float], family: str) -> str:
    """Markdown: one row per model, medians over motors [mrad]."""
    columns = [(kind, which) for kind in EXCITATIONS for which in SETS]
    rows = [
        [model, *(f"{1e3 * figures[f'{family}/{kind}/{model}/{which}']:.2f}" for kind, which in columns)]
        for model in MODELS
    ]
    head = [f"{family} [mrad]", *(f"{kind}, {which}" for kind, which in columns)]
    sampled = (f"{name} {figures[f'{family}/{name}']:.2f}" for name in ("coverage90", "two_sample_auc"))
    return markdown(head, rows) + f"\n\nSamples of the rollout prior: {', '.join(sampled)}."


def main() -> None:
    """Measure, write figures.json and tables.md, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    found: dict[str, float] = {}
    for family in settings.families:
        found |= measure(settings, family)
    write_json(settings.out / FIGURES, found)
    text = "\n\n".join(table(found, family) for family in settings.families)
    write_text(settings.out / "tables.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
