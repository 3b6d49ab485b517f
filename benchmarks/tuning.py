"""Same tuning for all recipes that Adam trains: one grid of learning rates and steps, evaluated on a separate bench.

    python benchmarks/tuning.py --out runs/tuning

Learning rates of a third, one and three times the preset's; then, at the best of them, twice the steps. The motors of
this bench, seed 1, are in no table of docs/fidelity.md; what is compared is the figure of those tables: the closed-loop
error on held-out gait and impacts of the motors trained on, at their posterior means. Writes tuning.md, results.json,
figures.json:
    rmse_mrad/POINT/PRESET    median over motors; the largest number of all where the training diverged
rollout and per_motor are fitted by searches and Gauss-Newton, tuned_pd by Nelder-Mead: they have no learning rate.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.latent import LatentActuator
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.facts import read_bench
from motorprior.exceptions import MotorPriorError
from motorprior.identification.judging.bench_fidelity import bench_errors
from motorprior.identification.presets import PRESETS, Preset
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.digests import code_digest, digest
from motorprior.pipeline.stage import RESULTS, fleet_files, read_results, write_results
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT

FACTORS = (1 / 3, 1.0, 3.0)
SEED = 1
DIVERGED = float(np.finfo(np.float64).max)


@dataclass(frozen=True)
class Settings:
    """Every recipe on one grid."""

    out: Path
    """Run folder; figures of this code and fleet that are there already are kept."""
    fleet: str = "mixed"
    """Population of motors."""
    presets: tuple[str, ...] = tuple(name for name, preset in PRESETS.items() if not preset.physics_first)
    """Which recipes; those with physics first have no learning rate that matters."""


def error(bench: Path, preset: Preset) -> float:
    """Median closed-loop error of one training [mrad]; infinite if it diverged."""
    from motorprior.identification.train import identify
    from motorprior.identification.training_data.windows import training_data

    log, facts = read_bench(bench)
    data = training_data(log, preset, str(bench))
    try:
        found = identify(data, preset, SEED)
    except MotorPriorError:  # the loss became infinite: all that is left to go wrong
        return DIVERGED
    name, motors = "model", facts.physical_motors()
    models = {name: lambda index: LatentActuator(found.network, found.mean[index])}
    return 1e3 * float(np.median(bench_errors(motors, models, SEED)["impacts"][name]))


def tune(settings: Settings) -> Results:
    """The grid; written after every training, so that an interrupted run goes on."""
    stage, files = settings.out / "identity.json", fleet_files(load_robot(DEFAULT_ROBOT), settings.fleet)
    wanted = {"code": code_digest(__file__), "fleet": [digest(file) for file in files]}
    same = stage.exists() and (settings.out / RESULTS).exists() and read_json(stage) == wanted
    results = read_results(settings.out) if same else Results()
    write_json(stage, wanted)
    for bench in ("rollout", "paper"):
        run_bench(Bench(settings.out / "bench" / bench, settings.fleet, bench, seed=SEED))

    def measured(name: str, preset: Preset) -> float:
        nonlocal results
        bench = settings.out / "bench" / ("paper" if name == "paper" else "rollout")
        if not results.where(model=name, part=point(preset)):
            results += Results((Result("rmse_mrad", "mrad", error(bench, preset), name, part=point(preset)),))
            write_results(settings.out, results)
            print(f"{name}, {point(preset)}: {shown(results.rows[-1].value)}", flush=True)
        return results.value(model=name, part=point(preset))

    for name in settings.presets:
        best = min(rates(PRESETS[name]), key=lambda preset, name=name: measured(name, preset))
        measured(name, doubled(best))
    return results


def rates(shipped: Preset) -> list[Preset]:
    """The recipe with every learning rate of the grid."""
    return [replace(shipped, learning_rate=factor * shipped.learning_rate) for factor in FACTORS]


def doubled(preset: Preset) -> Preset:
    """The recipe with twice the steps."""
    return replace(preset, steps=2 * preset.steps)


def point(preset: Preset) -> str:
    """Of the grid."""
    return f"rate {preset.learning_rate:.3g}, {preset.steps} steps"


def shown(value: float) -> str:
    """As text."""
    return "diverged" if value == DIVERGED else f"{value:.1f}"


def table(results: Results) -> str:
    """Markdown: one row per preset."""
    lines = ["| preset | learning rate: a third | shipped | three times | twice the steps at the best |"]
    lines.append("|---|---|---|---|---|")
    for name, shipped in PRESETS.items():
        grid = rates(shipped)
        points = [tuple(map(point, presets)) for presets in (grid[:1], grid[1:2], grid[2:], map(doubled, grid))]
        cells = [shown(row.value) for any_of in points for row in results.where(model=name, part=any_of)]
        if len(cells) == len(points):
            lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, write and print."""
    settings = tyro.cli(Settings, description=__doc__)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    text = table(tune(settings))
    write_text(settings.out / "tuning.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
