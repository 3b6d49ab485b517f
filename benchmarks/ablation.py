"""What a motor prior needs: latents, KL weight, motors, minutes of log. The curves of docs/fidelity.md.

    python benchmarks/ablation.py --out runs/ablation

Half an hour on two cores. Every point trains one prior on the same fleet and measures, on cases of its own,
  impacts   median joint RMSE of the training motors on gait + impacts [mrad]
  new       the same for 32 motors nobody trained on, at the posterior after 10 s of log
  auc       two-sample AUC of 256 draws against 256 other physical motors (0.5 is perfect)
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.physical import PhysicalActuator
from motorprior.artifacts import read_json, write_json
from motorprior.bench.behaviour import behaviours
from motorprior.bench.fleet import load_fleet
from motorprior.bench.record import bench_preset, record
from motorprior.cli.bench import training_motors
from motorprior.exceptions import ArtifactError
from motorprior.identification.validate import bench_errors
from motorprior.transfer.plots_style import MODEL_COLORS, OTHER_COLOR, png_bytes

STEPS, MOTORS = 10_000, 32
SWEEPS: dict[str, tuple[float, ...]] = {
    "latents": (2, 4, 8, 12, 16),
    "kl_weight": (1e-5, 3e-4, 1e-2),
    "motors": (4, 12, 32, 128),
    "seconds": (2, 5, 20, 60),
}
LABELS = {"latents": "latents", "kl_weight": "KL weight", "motors": "motors", "seconds": "seconds of log per motor"}
HELD_OUT, POPULATION = 32, 256
NAMES = {
    "impacts": "training motors",
    "new": "new motors, 10 s of log",
    "auc": "draws against physical motors",
}


@dataclass(frozen=True)
class Settings:
    """Sweep one setting at a time around preset rollout."""

    out: Path
    """Run folder: ablation.json and ablation.png; points that are there are kept."""
    fleet: str = "mixed"
    """Population of motors."""
    seed: int = 0
    """Seed of bench, training and validation."""
    adam_steps: int | None = None
    """Adam steps; the preset's own number if not given."""


def point(settings: Settings, sweep: str, value: float) -> dict[str, float]:
    """Train and measure one prior."""
    from motorprior.identification.adapt import adapt
    from motorprior.identification.distribution import energy_distance, two_sample_auc
    from motorprior.identification.presets import identification_preset
    from motorprior.identification.train import identify
    from motorprior.identification.windows import training_data

    preset = identification_preset("rollout")
    preset = replace(preset, steps=settings.adam_steps or preset.steps)
    if sweep == "latents":
        preset = replace(preset, num_latents=int(value))
    if sweep == "kl_weight":
        preset = replace(preset, kl_weight=value)
    motors = int(value) if sweep == "motors" else MOTORS
    steps = round(value / preset.period) if sweep == "seconds" else STEPS
    fleet, wide = load_fleet(settings.fleet), bench_preset("rollout" if steps >= STEPS else "adapt")
    units = training_motors(fleet, motors, settings.seed)
    found = identify(
        training_data(record(units, wide, steps, settings.seed, fleet), preset, "bench"), preset, settings.seed
    )
    rng = np.random.default_rng([settings.seed, 5])
    others = fleet.sample(rng, HELD_OUT)
    log = record(others, bench_preset("adapt"), 5000, settings.seed + 1, fleet)
    posterior = adapt(found.network, training_data(log, preset, "log"), preset, float(found.losses[-1]))
    errors = [
        np.median(bench_errors(who, {"m": lambda index, z=z: LatentActuator(found.network, z[index])}, settings.seed)
                  ["impacts"]["m"])
        for who, z in ((units, found.mean), (others, posterior.mean))
    ]  # fmt: skip
    physical = behaviours(PhysicalActuator(fleet.sample(rng, POPULATION))).values
    noise = rng.standard_normal((POPULATION, preset.num_latents))
    drawn = behaviours(LatentActuator(found.network, noise)).values
    return {
        "impacts": 1e3 * float(errors[0]),
        "new": 1e3 * float(errors[1]),
        "auc": two_sample_auc(drawn, physical, 0),
        "energy": energy_distance(drawn, physical),
    }


def picture(results: dict[str, dict[str, Any]]) -> bytes:
    """One column per sweep: errors above, two-sample AUC below."""
    shown = Figure(figsize=(12.0, 5.2), layout="constrained")
    axes = shown.subplots(2, len(SWEEPS), sharey="row")
    for column, sweep in enumerate(SWEEPS):
        points = sorted((float(value), found) for value, found in results.get(sweep, {}).items())
        x = [value for value, _ in points]
        for row, names in enumerate((("impacts", "new"), ("auc",))):
            for name, color in zip(names, (MODEL_COLORS["rollout"], OTHER_COLOR), strict=False):
                axes[row][column].plot(x, [found[name] for _, found in points], "o-", color=color, label=NAMES[name])
            axes[row][column].set_xscale("log")
            axes[row][column].set_ylim(bottom=0.5 if row else 0.0)
        axes[1][column].set_xlabel(LABELS[sweep])
    axes[0][0].set_ylabel("gait + impacts, RMSE [mrad]")
    axes[1][0].set_ylabel("two-sample AUC")
    for row in range(2):
        axes[row][0].legend(frameon=False, fontsize=8)
    return png_bytes(shown)


def main() -> None:
    """Measure what is missing, draw what is there."""
    settings = tyro.cli(Settings, description=__doc__)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    path, wanted = settings.out / "ablation.json", {k: v for k, v in asdict(settings).items() if k != "out"}
    try:
        kept = read_json(path)
    except ArtifactError:
        kept = {}
    results: dict[str, dict[str, Any]] = kept.get("results", {}) if kept.get("settings") == wanted else {}
    for sweep, values in SWEEPS.items():
        for value in values:
            if f"{value:g}" not in results.setdefault(sweep, {}):
                results[sweep][f"{value:g}"] = point(settings, sweep, value)
                write_json(path, {"settings": wanted, "results": results})
            print(sweep, f"{value:g}", {k: round(v, 3) for k, v in results[sweep][f"{value:g}"].items()}, flush=True)
    (settings.out / "ablation.png").write_bytes(picture(results))


if __name__ == "__main__":
    main()
