"""Every actuator model on the same data and the same held-out cases: the tables of docs/fidelity.md.

    python benchmarks/fidelity.py --fleet mixed --out runs/fidelity_mixed

Stages that are finished are kept. Twenty minutes per fleet on two cores.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_text
from motorprior.identification.evaluation.bench_fidelity import Ensemble, Prediction
from motorprior.identification.presets import identification_preset
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.stage import seconds_of, write_results
from motorprior.pipeline.validation.held_out import held_out_motors
from motorprior.pipeline.validation.validate import Validate, fidelity, load_priors, run_validate
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.transfer.metrics import COLUMNS

PRESETS = (
    "rollout", "per_motor", "one_motor", "latent_network", "one_network", "actuator_net", "paper_wide", "paper",
)  # fmt: skip
PROGRESS = Lines(sys.stderr)
MEMBERS = 3
"""Networks of the ensemble, of different seeds; it predicts the mean of their trajectories."""
RMSE = ("bench_impact_rmse", "bench_chirp_rmse", "standing_rmse", "suspended_rmse")
TORQUE = ("standing_torque_hf", "suspended_torque_hf")


@dataclass(frozen=True)
class Settings:
    """Identify every preset on one bench and validate all of them."""

    out: Path
    """Run folder."""
    fleet: str = "mixed"
    """Population of motors."""
    motors: int = 32
    """Motors on the bench."""
    steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification that trains a network; the preset's own number if not given."""
    seed: int = 0
    """Seed of bench, training and validation."""


def identify(settings: Settings, preset: str, name: str, seed: int = 0, torque: bool = True) -> Path:
    """The prior of one preset, trained unless it is there."""
    bench = settings.out / "bench" / ("paper" if preset == "paper" else "rollout")
    folder = settings.out / "priors" / name
    steps = settings.adam_steps if identification_preset(preset).trains else None
    run_identify(Identify(bench, folder, preset, settings.seed + seed, steps, torque), PROGRESS)
    return folder / PRIOR


def measure(settings: Settings) -> Results:
    """Everything; the position-only prior and the ensemble are models of their own names."""
    for preset in ("rollout", "paper"):
        run_bench(
            Bench(
                settings.out / "bench" / preset, settings.fleet, preset, settings.motors, settings.steps, settings.seed
            ),
            PROGRESS,
        )
    priors = tuple(identify(settings, preset, preset) for preset in PRESETS)
    results = run_validate(Validate(priors, settings.out / "validate" / "all", settings.seed), PROGRESS)
    blind = identify(settings, "rollout", "position_only", torque=False)
    found = run_validate(Validate((blind,), settings.out / "validate" / "position_only", settings.seed), PROGRESS)
    return results + found.where(model="rollout").having(model="position_only") + ensemble(settings)


def ensemble(settings: Settings) -> Results:
    """One_network with MEMBERS seeds; without latents it is the same model for all motors."""
    robot = load_robot(DEFAULT_ROBOT)
    paths = [identify(settings, "one_network", f"member_{seed}", seed) for seed in range(1, MEMBERS + 1)]
    members, facts = [MotorPrior.load(path) for path in paths], load_priors(robot, (paths[0],))[1]
    model: dict[str, Prediction] = {
        "ensemble": lambda index: Ensemble(tuple(member.training_motors(index) for member in members))
    }
    results = Results((Result("identify_seconds", "s", sum(seconds_of(path.parent) for path in paths), "ensemble"),))
    with PROGRESS.start("the ensemble: bench, standing robot, suspended robot, twice", 6) as task:
        for which, motors in (("train", facts.physical_motors()), ("held_out", held_out_motors(facts))):
            found = fidelity(robot, motors, model, which, settings.seed, task)
            results += found.where(model="ensemble", quantity=COLUMNS)
    return results


def table(results: Results, motors: str) -> str:
    """Markdown: one row per model; RMSE [mrad], medians, and means in brackets.

    Torque above 20 Hz is a ratio to the physical motors' own: more is chatter, less is missing life.
    """
    here = results.where(motors=motors)
    errors = here.where(quantity="bench_impact_rmse", statistic="median")
    lines = [
        "| model | gait + impacts [mrad] | chirp [mrad] | standing [mrad] | suspended [mrad] | torque > 20 Hz over the "
        "physical motors': standing | suspended | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for model in sorted(errors.distinct("model"), key=lambda model: -errors.value(model=model)):
        cells = [cell(here, quantity, model, ".1f", 1e3) for quantity in RMSE]
        cells += [cell(here, quantity, model, ".2f", 1.0, over="physical") for quantity in TORQUE]
        seconds = results.where(quantity="identify_seconds", model=model)
        cells.append("".join(f"{row.value:.0f}" for row in seconds))
        lines.append(f"| {model} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(results: Results, quantity: str, model: str, form: str, factor: float, over: str | None = None) -> str:
    """Median and, in brackets, mean of a quantity; as a ratio to those of the model ``over``, if given."""
    found = results.where(quantity=quantity)
    median, mean = (
        factor
        * found.value(model=model, statistic=statistic)
        / (1.0 if over is None else found.value(model=over, statistic=statistic))
        for statistic in ("median", "mean")
    )
    return f"{median:{form}} ({mean:{form}})"


def main() -> None:
    """Measure, write results.json, figures.json and tables.md, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    results = measure(settings)
    write_results(settings.out, results)
    text = "\n\n".join(
        f"{motors.replace('_', '-')} motors\n\n{table(results, motors)}" for motors in ("train", "held_out")
    )
    write_text(settings.out / "tables.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
