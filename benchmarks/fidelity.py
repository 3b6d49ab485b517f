"""All actuator models on the same data and the same held-out cases: the tables of docs/fidelity.md.

    python benchmarks/fidelity.py --fleet mixed --out runs/fidelity_mixed

Finished stages are reused. Twenty minutes per fleet on two cores.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

import simulated_arms
from figures import PROGRESS, markdown
from fleet_validation import validate_on_bench
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.bench_folder import read_bench, record_bench
from motorprior.identification.presets import identification_preset, network_steps
from motorprior.priors.fit_prior import PRIOR, fit_recipe, provenance_of
from motorprior.results import Result, Results, write_results
from motorprior.stage import FIGURES, MARKER

PRESETS = (
    "rollout", "per_motor", "latent_network", "one_network", "actuator_net", "paper_wide", "paper",
)  # fmt: skip
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
    arms: int = 20  # simulated arms of `simulated_arms`, whose figures are written, too


def identify(settings: Settings, preset: str, torque: bool = True) -> Path:
    """The prior of one preset, without torques in the log the position-only one; made if the file does not exist."""
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
    log = log if torque else replace(log, joint_torque=None)
    folder = settings.out / "priors" / (preset if torque else "position_only")
    recipe = identification_preset(preset, network_steps(preset, settings.adam_steps))
    fit_recipe(log, preset, recipe, settings.seed, folder, PROGRESS, provenance)
    return folder / PRIOR


def measure(settings: Settings) -> Results:
    """All results, including the position-only prior."""
    folder = settings.out / "validate"
    paths = {preset: identify(settings, preset) for preset in PRESETS}
    results = validate_on_bench(
        tuple(paths.values()), folder / "all", seed=settings.seed, progress=PROGRESS
    )
    paths["position_only"] = alone = identify(settings, "rollout", torque=False)
    found = validate_on_bench(
        [alone], folder / "position_only", seed=settings.seed, progress=PROGRESS
    )
    seconds = {model: read_json(path.parent / MARKER)["seconds"] for model, path in paths.items()}
    times = (Result("identify_seconds", "s", value, model) for model, value in seconds.items())
    renamed = (replace(row, model="position_only") for row in found.where(model="rollout"))
    return results + Results([*renamed, *times])


def table(results: Results, motors: str) -> str:
    """Markdown: one row per model; RMSE [mrad] and torque above 20 Hz, medians, and means in brackets."""
    here = results.where(motors=motors)
    rows = []
    errors = here.where(quantity="bench_impact_rmse", statistic="median")
    for model in sorted(errors.distinct("model"), key=lambda model: -errors.value(model=model)):
        cells = [cell(here, quantity, model, ".1f", 1e3) for quantity in RMSE]
        cells += [cell(here, quantity, model, ".2f", 1.0, over="physical") for quantity in TORQUE]
        seconds = results.where(quantity="identify_seconds", model=model)
        rows.append([model, *cells, "".join(f"{row.value:.0f}" for row in seconds)])
    return markdown(HEAD, rows)


def cell(
    results: Results, quantity: str, model: str, form: str, factor: float, over: str | None = None
) -> str:
    """Median and, in brackets, mean of a quantity; divided by that of the model ``over``, if given."""
    found = results.where(quantity=quantity)
    values = []
    for statistic in ("median", "mean"):
        reference = 1.0 if over is None else found.value(model=over, statistic=statistic)
        values.append(factor * found.value(model=model, statistic=statistic) / reference)
    return f"{values[0]:{form}} ({values[1]:{form}})"


def main() -> None:
    """Measure, write results.json, figures.json and tables.md, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    results = measure(settings)
    write_results(settings.out, results)
    arms = simulated_arms.figures(
        simulated_arms.Settings(settings.out / "arms", settings.arms, seed=settings.seed)
    )
    write_json(settings.out / FIGURES, read_json(settings.out / FIGURES) | arms)
    text = f"train motors\n\n{table(results, 'train')}\n\nheld-out motors\n\n{table(results, 'held_out')}"
    write_text(settings.out / "tables.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
