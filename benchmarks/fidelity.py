"""All actuator models on the same data and the same held-out cases: the tables of docs/fidelity.md.

    python benchmarks/fidelity.py --fleet mixed --out runs/fidelity_mixed

Finished stages are reused. Twenty minutes per fleet on two cores.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

import simulated_arms
from figures import PROGRESS, markdown
from fleet_validation import ADAPT_SECONDS, validate_on_bench
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.bench_folder import read_bench, record_bench
from motorprior.identification.presets import identification_preset, network_steps
from motorprior.priors.fit_prior import PRIOR_FILE, fit_recipe, provenance_of
from motorprior.results import Result, Results, write_results
from motorprior.stage import FIGURES, MARKER
from virtual_fleets.held_out_motors import POPULATION

PRESETS = (
    "rollout", "per_motor", "latent_network", "one_network", "actuator_net", "paper_wide", "paper",
)  # fmt: skip
POSITION_ONLY = "position_only"  # the prior of preset rollout without torques
RMSE = ("bench_impact_rmse", "bench_chirp_rmse", "standing_rmse", "suspended_rmse")
TORQUE = ("standing_torque_hf", "suspended_torque_hf")
HEAD = (
    "model", "gait + impacts [mrad]", "chirp [mrad]", "standing [mrad]", "suspended [mrad]",
    "torque > 20 Hz over the physical motors': standing", "suspended", "s",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """Identify every preset on one bench and validate all of them."""

    out: Path  # run folder
    fleet: str = "mixed"  # population of motors
    motors: int = 32  # motors on the bench
    steps: int = 10_000  # samples per motor
    adam_steps: int | None = None  # Adam steps of every network; the preset's number if not given
    seed: int = 0  # seed of bench, training and validation
    presets: tuple[str, ...] = PRESETS  # presets of the priors
    position_only: bool = True  # whether to identify a prior from positions only, too
    # lengths of log to which priors are adapted for held-out motors [s]
    adapt_seconds: tuple[float, ...] = ADAPT_SECONDS
    population: int = POPULATION  # samples of a prior for the two-sample test
    arms: int = 20  # simulated arms of `simulated_arms`, whose figures are written, too


def identify(settings: Settings, preset: str, torque: bool = True) -> Path:
    """The file of the prior of one preset; it is made if it does not exist.

    Without ``torque`` the prior is identified from positions only.
    """
    bench = settings.out / "bench" / ("paper" if preset == "paper" else "rollout")
    record_bench(
        fleet=settings.fleet,
        motors=settings.motors,
        steps=settings.steps,
        preset=bench.name,
        seed=settings.seed,
        out=bench,
        progress=PROGRESS,
    )
    log, recorded = read_bench(bench)
    provenance = provenance_of([log], bench=recorded.as_json())
    if not torque:
        log = replace(log, joint_torque=None)

    folder = settings.out / "priors" / (preset if torque else POSITION_ONLY)
    recipe = identification_preset(preset, network_steps(preset, settings.adam_steps))
    fit_recipe(log, preset, recipe, settings.seed, folder, PROGRESS, provenance)
    return folder / PRIOR_FILE


def measure(settings: Settings) -> Results:
    """All results, including the prior from positions only if it is wanted."""
    folder = settings.out / "validate"
    paths = {preset: identify(settings, preset) for preset in settings.presets}
    results = _validate(settings, tuple(paths.values()), folder / "all")

    rows = []
    if settings.position_only:
        # this prior has the preset of another one, so it is validated alone
        paths[POSITION_ONLY] = identify(settings, "rollout", torque=False)
        of_position_only = _validate(settings, [paths[POSITION_ONLY]], folder / POSITION_ONLY)
        for row in of_position_only.where(model="rollout"):
            rows.append(replace(row, model=POSITION_ONLY))
    for model, path in paths.items():
        seconds = read_json(path.parent / MARKER)["seconds"]
        rows.append(Result("identify_seconds", "s", seconds, model))
    return results + Results(rows)


def _validate(settings: Settings, priors: Sequence[Path], out: Path) -> Results:
    return validate_on_bench(
        priors,
        out,
        seed=settings.seed,
        adapt_seconds=settings.adapt_seconds,
        population=settings.population,
        progress=PROGRESS,
    )


def table(results: Results, motors: str) -> str:
    """Markdown: one row per model; RMSE [mrad] and torque above 20 Hz.

    Cells are medians, and means in brackets.
    """
    of_motors = results.where(motors=motors)
    errors = of_motors.where(quantity="bench_impact_rmse", statistic="median")
    models = sorted(errors.distinct("model"), key=lambda model: -errors.value(model=model))
    rows = []
    for model in models:
        cells = [model]
        cells += [cell(of_motors, quantity, model, ".1f", 1e3) for quantity in RMSE]
        for quantity in TORQUE:
            cells.append(cell(of_motors, quantity, model, ".2f", 1.0, over="physical"))
        seconds = results.where(quantity="identify_seconds", model=model)
        cells.append("".join(f"{row.value:.0f}" for row in seconds))
        rows.append(cells)
    return markdown(HEAD, rows)


def cell(
    results: Results, quantity: str, model: str, form: str, factor: float, over: str | None = None
) -> str:
    """Median and, in brackets, mean of a quantity; relative to the model ``over``, if given."""
    of_quantity = results.where(quantity=quantity)
    values = []
    for statistic in ("median", "mean"):
        denominator = 1.0
        if over is not None:
            denominator = of_quantity.value(model=over, statistic=statistic)
        value = of_quantity.value(model=model, statistic=statistic)
        values.append(factor * value / denominator)
    median, mean = values
    return f"{median:{form}} ({mean:{form}})"


def main() -> None:
    """Measure, write results.json, figures.json and tables.md, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    results = measure(settings)
    write_results(settings.out, results)

    arms = simulated_arms.figures(
        simulated_arms.Settings(settings.out / "arms", settings.arms, seed=settings.seed)
    )
    path = settings.out / FIGURES
    write_json(path, read_json(path) | arms)

    text = f"train motors\n\n{table(results, 'train')}\n\n"
    text += f"held-out motors\n\n{table(results, 'held_out')}"
    write_text(settings.out / "tables.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
