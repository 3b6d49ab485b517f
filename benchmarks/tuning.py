"""Same tuning for all trained recipes: one grid of learning rates and Adam steps, evaluated on a separate bench.

    python benchmarks/tuning.py --out runs/tuning

Learning rates of a third, one and three times the preset's; then, at the best of them, twice the steps. The motors of
this bench, seed 1, are in no table of docs/fidelity.md; what is compared is the figure of those tables: the closed-loop
error on held-out gait and impacts of the motors trained on, at their posterior means. Writes tuning.md, figures.json:
    rmse_mrad/PRESET/LEARNING_RATE/STEPS    median over motors; the largest number of all where the training diverged
per_motor_play is fitted by a search and Gauss-Newton, tuned_pd by Nelder-Mead: they have no learning rate.
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
from motorprior.identification.presets import PRESETS, Preset
from motorprior.identification.validate import bench_errors
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.stage import code_digest, digest, fleet_files

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
    presets: tuple[str, ...] = tuple(PRESETS)
    """Which recipes."""


def error(bench: Path, preset: Preset) -> float:
    """Median closed-loop error of one training [mrad]; infinite if it diverged."""
    from motorprior.identification.train import identify
    from motorprior.identification.windows import training_data

    log, facts = read_bench(bench)
    data = training_data(log, preset, str(bench))
    try:
        found = identify(data, preset, SEED)
    except MotorPriorError:  # the loss became infinite: all that is left to go wrong
        return DIVERGED
    name, motors = "model", facts.physical_motors()
    models = {name: lambda index: LatentActuator(found.network, found.mean[index])}
    return 1e3 * float(np.median(bench_errors(motors, models, SEED)["impacts"][name]))


def tune(settings: Settings) -> dict[str, float]:
    """The grid; written after every training, so that an interrupted run goes on."""
    path, stage = settings.out / "figures.json", settings.out / "identity.json"
    wanted = {"code": code_digest("identify"), "fleet": [digest(file) for file in fleet_files(settings.fleet)]}
    same = stage.exists() and path.exists() and read_json(stage) == wanted
    figures: dict[str, float] = read_json(path) if same else {}
    write_json(stage, wanted)
    for bench in ("rollout", "paper"):
        run_bench(Bench(settings.out / "bench" / bench, settings.fleet, bench, seed=SEED))
    for name in settings.presets:
        bench, shipped = settings.out / "bench" / ("paper" if name == "paper" else "rollout"), PRESETS[name]

        def measured(preset: Preset, name: str = name, bench: Path = bench) -> float:
            key = f"rmse_mrad/{name}/{preset.learning_rate:.3g}/{preset.steps}"
            if key not in figures:
                figures[key] = error(bench, preset)
                write_json(path, figures)
                print(f"{key}: {shown(figures[key])}", flush=True)
            return figures[key]

        rates = [replace(shipped, learning_rate=factor * shipped.learning_rate) for factor in FACTORS]
        best = min(rates, key=measured)
        measured(replace(best, steps=2 * shipped.steps))
    return figures


def shown(value: float) -> str:
    """As text."""
    return "diverged" if value == DIVERGED else f"{value:.1f}"


def table(figures: dict[str, float]) -> str:
    """Markdown: one row per preset."""
    lines = ["| preset | learning rate: a third | shipped | three times | twice the steps at the best |"]
    lines.append("|---|---|---|---|---|")
    for name, shipped in PRESETS.items():
        once = [figures.get(f"rmse_mrad/{name}/{f * shipped.learning_rate:.3g}/{shipped.steps}") for f in FACTORS]
        twice = [value for key, value in figures.items() if key.split("/")[1::2] == [name, str(2 * shipped.steps)]]
        if None not in once and twice:
            lines.append(f"| `{name}` | " + " | ".join(shown(value) for value in (*once, *twice)) + " |")
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
