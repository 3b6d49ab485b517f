"""Ablation of the motor prior over latents, KL weight, motors and seconds of log: the curves of docs/ablation.png.

    python benchmarks/ablation.py --out runs/ablation

A quarter of an hour on two cores. One setting at a time around preset rollout, all on the same bench (segments of a
second, so that the shortest log has every excitation), with fewer Adam steps than the preset's and several seeds, each
with motors of its own. A point trains one prior and measures
  train     median joint RMSE of the training motors on gait + impacts [mrad]
  new       the same for held-out motors, at the posterior after 10 s of log
  auc       two-sample AUC of 256 draws against 256 other physical motors (0.5 is perfect)
  energy    energy distance of the same (0 is perfect)
"""

from __future__ import annotations

import hashlib
import inspect
import itertools
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.physical import MotorParameters
from motorprior.artifacts import read_json, write_json
from motorprior.bench.behaviour import behaviours
from motorprior.bench.facts import training_motors
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.bench_fidelity import bench_errors
from motorprior.identification.presets import identification_preset
from motorprior.pipeline.stage import code_digest, digest, fleet_files
from motorprior.report.plots_style import MODEL_COLORS, OTHER_COLOR, png_bytes
from motorprior.robots.pupper_v2.robot import PUPPER_V2

BENCH, RECIPE = bench_preset("adapt"), identification_preset("rollout")
CENTER = {
    "latents": float(RECIPE.num_latents), "mixed": 0.0, "kl_weight": RECIPE.kl_weight, "motors": 32.0, "seconds": 20.0,
}  # fmt: skip
"""Preset rollout on its usual bench, one latent per constant: measured once."""
SWEEPS: dict[str, tuple[float, ...]] = {
    "latents": (2, 4, 8, 14, 20),
    "kl_weight": (1e-5, 1e-2),
    "motors": (4, 8, 16, 64, 128),
    "seconds": (5, 10, 60),
}
LABELS = {
    "latents": "latents that mix the constants\n(diamond: one latent for each constant)",
    "kl_weight": "KL weight",
    "motors": "motors",
    "seconds": "seconds of log per motor",
}
NEW_MOTORS, NEW_SECONDS, POPULATION = 32, 10.0, 256
TAG = 61
"""Tag of the random streams that draw held-out motors."""
ROWS = (
    ("gait + impacts\nRMSE [mrad]", {"train": "training motors", "new": "new motors, 10 s of log"}, 0.0),
    ("two-sample AUC", {"auc": "draws against physical motors"}, 0.5),
    ("energy distance", {"energy": "draws against physical motors"}, 0.0),
)
"""Label, figures and lower end of the axes of each row of the picture."""


@dataclass(frozen=True)
class Settings:
    """Sweep one setting at a time around preset rollout."""

    out: Path
    """Run folder: ablation.json and ablation.png; points that are there are kept."""
    fleet: str = "mixed"
    """Population of motors."""
    seeds: int = 2
    """Number of seeds of motors, bench and training; the picture shows their mean and each of them."""
    adam_steps: int = 1000
    """Adam steps of a training."""
    workers: int = 2
    """Points at a time."""
    only: tuple[str, ...] = tuple(SWEEPS)
    """Sweeps to measure; the picture shows whatever is there."""


@dataclass(frozen=True)
class Point:
    """What to train."""

    fleet: str
    seed: int
    adam_steps: int
    latents: int
    mixed: bool
    kl_weight: float
    motors: int
    seconds: float

    @property
    def key(self) -> str:
        """Its name among the results."""
        return f"seed {self.seed}: " + ", ".join(f"{name} {getattr(self, name):g}" for name in CENTER)


def points(settings: Settings) -> Iterator[Point]:
    """The centre and every other value of every sweep, seed by seed."""
    for seed in range(settings.seeds):
        others = (_values_at(sweep, value) for sweep in settings.only for value in SWEEPS[sweep])
        for chosen in (CENTER, *(values for values in others if values != CENTER)):
            yield _point(settings, seed, chosen)


def _values_at(sweep: str, value: float) -> dict[str, float]:
    """Settings of a point of a sweep. Another number of latents than constants needs a decoder that mixes them."""
    return CENTER | {sweep: value} | ({"mixed": 1.0} if sweep == "latents" else {})


def _point(settings: Settings, seed: int, values: dict[str, float]) -> Point:
    return Point(
        settings.fleet, seed, settings.adam_steps, int(values["latents"]), bool(values["mixed"]), values["kl_weight"],
        int(values["motors"]), values["seconds"],
    )  # fmt: skip


def measure(point: Point) -> dict[str, float]:
    """Train and measure one prior."""
    from motorprior.identification.distribution import energy_distance, two_sample_auc
    from motorprior.identification.latent_fit import adapt, window_losses
    from motorprior.identification.train import identify
    from motorprior.identification.windows import training_data

    preset = replace(
        RECIPE,
        steps=point.adam_steps,
        num_latents=point.latents,
        own_latents=not point.mixed,
        kl_weight=point.kl_weight,
    )
    fleet = load_fleet(point.fleet)
    motors, rng = training_motors(fleet, point.motors, point.seed), np.random.default_rng([point.seed, TAG])
    log = record(motors, BENCH, round(point.seconds / BENCH.period), point.seed, fleet)
    data = training_data(log, preset, "bench")
    found = identify(data, preset, point.seed)
    temperature = float(window_losses(found.network, data, preset, found.mean).mean())
    new = fleet.sample(NEW_MOTORS, rng)
    log = record(new, BENCH, round(NEW_SECONDS / BENCH.period), point.seed + 1_000_000, fleet)
    posterior = adapt(found.network, training_data(log, preset, "log"), preset, temperature)
    physical = behaviours(fleet.sample(POPULATION, rng).actuator()).values
    drawn = behaviours(LatentActuator(found.network, rng.standard_normal((POPULATION, point.latents)))).values
    return {
        "train": 1e3 * impact_error(LatentActuator(found.network, found.mean), motors, point.seed),
        "new": 1e3 * impact_error(LatentActuator(found.network, posterior.mean), new, point.seed),
        "auc": two_sample_auc(drawn, physical, point.seed),
        "energy": energy_distance(drawn, physical),
    }


def impact_error(model: LatentActuator, motors: MotorParameters, seed: int) -> float:
    """Median over motors of the joint RMSE [rad] on held-out gaits with impacts."""
    return float(np.median(bench_errors(motors, {"model": lambda _: model}, seed)["impacts"]["model"]))


def sweep(settings: Settings) -> dict[str, dict[str, float]]:
    """All points, those that the run folder has and those that it lacks, by `Point.key`."""
    path, wanted = settings.out / "ablation.json", identity(settings)
    try:
        kept: Any = read_json(path)
    except ArtifactError:
        kept = {}
    results: dict[str, dict[str, float]] = kept["results"] if kept.get("identity") == wanted else {}
    missing = [point for point in points(settings) if point.key not in results]
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC"):  # before the workers import numpy and JAX
        os.environ[name] = "1"
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    with ProcessPoolExecutor(settings.workers, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(measure, point): point for point in missing}
        for number, done in enumerate(as_completed(waiting), 1):
            key = waiting[done].key
            results[key] = done.result()
            write_json(path, {"identity": wanted, "results": results})
            print(f"{number}/{len(missing)}", key, {k: round(v, 3) for k, v in results[key].items()}, flush=True)
    return results


def identity(settings: Settings) -> dict[str, Any]:
    """What the points depend on besides their own settings; how they are drawn is no part of it."""
    measured = "".join(inspect.getsource(function) for function in (measure, impact_error))
    return {
        "code": code_digest("identify"),
        "measured": hashlib.sha256(measured.encode()).hexdigest()[:16],
        "bench": repr(BENCH),
        "recipe": repr(RECIPE),
        "new": [NEW_MOTORS, NEW_SECONDS, POPULATION],
        "fleet": [digest(path) for path in fleet_files(PUPPER_V2, settings.fleet)],
        "adam_steps": settings.adam_steps,
    }


def picture(settings: Settings, results: dict[str, dict[str, float]]) -> bytes:
    """One column per sweep, one row per entry of ROWS."""
    shown = Figure(figsize=(12.0, 7.0), layout="constrained")
    grid = shown.subplots(len(ROWS), len(SWEEPS), sharey="row")
    for (row, (label, names, _)), (column, name) in itertools.product(enumerate(ROWS), enumerate(SWEEPS)):
        axes = grid[row][column]
        for figure, color in zip(names, (MODEL_COLORS["rollout"], OTHER_COLOR), strict=False):
            _curve(axes, settings, results, name, figure, color, names[figure])
        axes.axvline(CENTER[name], color="0.85", lw=4, zorder=0)
        axes.set_xscale("log")
        axes.set_xticks(_values(name), [f"{value:g}" for value in _values(name)], fontsize=8)
        axes.minorticks_off()
        if column == 0:
            axes.set_ylabel(label)
            axes.legend(frameon=False, fontsize=8, loc="lower left" if row == 1 else "best")
        if row == len(ROWS) - 1:
            axes.set_xlabel(LABELS[name])
    for row, (_, names, lowest) in enumerate(ROWS):
        highest = max((found[figure] for found in results.values() for figure in names), default=1.0)
        grid[row][0].set_ylim(lowest, highest + 0.08 * (highest - lowest))
    return png_bytes(shown)


def _values(name: str) -> list[float]:
    """Values of a sweep, with its centre if that belongs to it."""
    return sorted({*SWEEPS[name], *(() if name == "latents" else (CENTER[name],))})


def _curve(
    axes: Axes, settings: Settings, results: dict[str, dict[str, float]], name: str, figure: str, color: str, label: str
) -> None:
    """Mean over seeds as a line, every seed as a dot."""
    x, means = [], []
    for value in _values(name):
        found = _found(settings, results, _values_at(name, value), figure)
        if found:
            axes.plot([value] * len(found), found, ".", color=color, alpha=0.6)
            x.append(value)
            means.append(np.mean(found))
    axes.plot(x, means, "-", color=color, label=label)
    if name == "latents" and (found := _found(settings, results, CENTER, figure)):
        axes.plot(CENTER[name], np.mean(found), "D", color=color, markersize=5)


def _found(
    settings: Settings, results: dict[str, dict[str, float]], values: dict[str, float], figure: str
) -> list[float]:
    """A figure of a point, by seed."""
    keys = [_point(settings, seed, values).key for seed in range(settings.seeds)]
    return [results[key][figure] for key in keys if key in results]


def main() -> None:
    """Measure what is missing, draw what is there.

    Raises:
        ConfigError: a sweep that does not exist.
    """
    settings = tyro.cli(Settings, description=__doc__)
    if unknown := set(settings.only) - set(SWEEPS):
        raise ConfigError(f"no sweep {sorted(unknown)}", remedy=f"use some of {', '.join(SWEEPS)}")
    settings.out.mkdir(parents=True, exist_ok=True)
    results = sweep(settings)
    (settings.out / "ablation.png").write_bytes(picture(settings, results))


if __name__ == "__main__":
    main()
