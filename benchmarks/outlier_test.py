"""Power of the outlier test of `motorprior adapt` at its nominal false-alarm rate.

    python benchmarks/outlier_test.py runs/prior_mixed/prior.safetensors --json outlier_test.json

MOTORS motors of the fleet, unchanged and with one constant changed, each adapted to some seconds of log:
    noticed/CHANGE/SECONDS     fraction of motors with a p-value below FALSE_ALARMS
    rmse_mrad/CHANGE/SECONDS   median closed-loop error of the posterior means on held-out gait + impacts
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from figures import markdown
from motorprior.artifacts import write_json
from motorprior.bench.recording import bench_preset, record
from motorprior.commands.validate import load_priors
from motorprior.identification.adapt import FALSE_ALARMS, adapt_to, outlier_test
from motorprior.identification.evaluation.bench_truth import HELD_OUT_SEED, bench_errors
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT

CHANGES: dict[str, dict[str, float]] = {
    "none": {},
    "kp and kd x 2.5": {"kp": 2.5, "kd": 2.5},
    "kd / 4": {"kd": 0.25},
    "delay x 3": {"delay": 3.0},
    "armature x 4": {"armature": 4.0},
    "coulomb x 4": {"coulomb": 4.0},
    "backlash x 5": {"backlash": 5.0},
    "torque_limit / 2": {"torque_limit": 0.5},
}
SECONDS = (2.0, 10.0, 30.0)
MOTORS, STREAM = 16, 57


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    prior: tyro.conf.Positional[Path]  # prior of preset rollout, identified from a bench
    json: Path | None = None  # file for the figures


def measure(path: Path) -> Results:
    """Detection rate and error for every change."""
    priors, bench = load_priors(load_robot(DEFAULT_ROBOT), (path,))
    (prior,) = priors.values()
    own = bench.fleet.sample(MOTORS, np.random.default_rng([HELD_OUT_SEED, bench.seed, STREAM]))
    rows: list[Result] = []
    for seconds in SECONDS:
        for name, change in CHANGES.items():
            motors = own.scaled(change)
            preset = bench_preset("adapt")
            log = record(motors, preset, round(seconds / preset.period), HELD_OUT_SEED + bench.seed, bench.fleet)
            found = adapt_to(prior, log)
            p_value = outlier_test(prior, log, found).p_value
            model = {"model": lambda index, z=found.mean: prior.model.motors(z[index])}
            error = bench_errors(motors, model, bench.seed)["impacts"]["model"]
            detected, rmse = float(np.mean(p_value < FALSE_ALARMS)), 1e3 * float(np.median(error))
            rows.append(Result("noticed", "1", detected, part=name, seconds=seconds))
            rows.append(Result("rmse_mrad", "mrad", rmse, part=name, seconds=seconds))
    return Results.of(rows)


def main() -> None:
    """Measure, print a table, write."""
    settings = tyro.cli(Settings, description=__doc__)
    results, rows = measure(settings.prior), []
    for name in CHANGES:
        found = [results.where(part=name, seconds=seconds) for seconds in SECONDS]
        cells = [f"{one.value(quantity='noticed'):.2f}, {one.value(quantity='rmse_mrad'):.1f}" for one in found]
        rows.append([name, *cells])
    print(markdown(["changed constant", *(f"detected, error [mrad] in {s:g} s" for s in SECONDS)], rows))
    if settings.json is not None:
        write_json(settings.json, results.to_figures())


if __name__ == "__main__":
    main()
