"""Every actuator model on the same data and the same held-out cases: the tables of docs/fidelity.md.

    python benchmarks/fidelity.py --fleet mixed --out runs/fidelity_mixed

Stages that are finished are kept. Twenty minutes per fleet on two cores.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.artifacts import write_json
from motorprior.cli.bench import Bench, run_bench
from motorprior.cli.identify import PRIOR, Identify, run_identify
from motorprior.cli.validate import Validate, run_validate

PRESETS = (
    "rollout", "per_motor", "one_motor", "latent_network", "one_network", "actuator_net", "paper_wide", "paper",
)  # fmt: skip
MEMBERS = 3
"""Networks of the ensemble, of different seeds; its error is that of its members on average."""
COLUMNS = ("bench_impact_rmse", "standing_rmse", "hung_rmse", "standing_torque_hf", "hung_torque_hf")


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
    """Adam steps of each identification; the preset's own number if not given."""
    seed: int = 0
    """Seed of bench, training and validation."""


def identify(settings: Settings, preset: str, name: str, seed: int = 0, torque: bool = True) -> Path:
    """The prior of one preset, trained unless it is there."""
    bench = settings.out / "bench" / ("paper" if preset == "paper" else "rollout")
    folder = settings.out / "priors" / name
    run_identify(Identify(bench, folder, preset, settings.seed + seed, settings.adam_steps, torque))
    return folder / PRIOR


def measure(settings: Settings) -> dict[str, float]:
    """All figures; those of the position-only prior and of the ensemble under names of their own."""
    for preset in ("rollout", "paper"):
        run_bench(
            Bench(
                settings.out / "bench" / preset, settings.fleet, preset, settings.motors, settings.steps, settings.seed
            )
        )
    priors = tuple(identify(settings, preset, preset) for preset in PRESETS)
    figures = run_validate(Validate(priors, settings.out / "validate" / "all", settings.seed))
    blind = identify(settings, "rollout", "position_only", torque=False)
    found = run_validate(Validate((blind,), settings.out / "validate" / "position_only", settings.seed))
    figures |= {
        name.replace("/rollout", "/position_only"): value for name, value in found.items() if "/rollout" in name
    }
    members = [identify(settings, "one_network", f"member_{seed}", seed) for seed in range(1, MEMBERS + 1)]
    parts = [
        run_validate(Validate((path,), settings.out / "validate" / path.parent.name, settings.seed, adapt_seconds=()))
        for path in members
    ]
    for name in parts[0]:
        if "/one_network" in name:
            figures[name.replace("/one_network", "/ensemble")] = sum(part[name] for part in parts) / MEMBERS
    figures["identify_seconds/ensemble"] *= MEMBERS
    return figures


def table(figures: dict[str, float], motors: str) -> str:
    """Markdown: one row per model, mrad and N·m; medians, and means in brackets for the bench."""
    prefix, ending = "bench_impact_rmse/", f"/{motors}"
    models = [name[len(prefix) : -len(ending)] for name in figures if name.startswith(prefix) and name.endswith(ending)]
    models.sort(key=lambda model: -figures[f"{prefix}{model}{ending}"])
    lines = [
        "| model | gait + impacts [mrad] | standing [mrad] | hung [mrad] | torque > 20 Hz standing, hung [N·m] | s |",
        "|---|---|---|---|---|---|",
    ]
    for model in models:
        impacts, standing, hung, high, hung_high = (figures[f"{column}/{model}{ending}"] for column in COLUMNS)
        mean = figures.get(f"bench_impact_rmse_mean/{model}{ending}", float("nan"))
        seconds = figures.get(f"identify_seconds/{model}")
        lines.append(
            f"| {model} | {1e3 * impacts:.1f} ({1e3 * mean:.1f}) | {1e3 * standing:.1f} | {1e3 * hung:.1f} | "
            f"{high:.3f}, {hung_high:.3f} | {'' if seconds is None else f'{seconds:.0f}'} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, write figures.json and tables.md, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    figures = measure(settings)
    write_json(settings.out / "figures.json", figures)
    text = "\n\n".join(
        f"{motors.replace('_', '-')} motors\n\n{table(figures, motors)}" for motors in ("train", "held_out")
    )
    (settings.out / "tables.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
