"""The demo on several benches of motors: are its results the same for every seed?

    python benchmarks/demo_seeds.py --out runs/demo_seeds

Seed k of the demo has its own motors, robots, floors, pushes and searches. Its folder is
OUT/seed_k, as of `motorprior demo --seed k`; finished demos are not repeated. Written are

    figures.json    ENVIRONMENT/CONDITION/QUANTITY, with /low and /high: mean over the seeds with
                    its 95 % interval; QUANTITY is a metric of the walks. minus_sampled_prior/…:
                    a condition less the sampled prior on the same bench
    table.md        the same: time upright and speed, step frequency and foot lift

Five minutes per seed on two cores.
"""

import math
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from figures import markdown, run_benchmark
from motorprior.artifacts import write_text
from motorprior.report.plots_style import model_label
from motorprior.studies.statistics import (
    IN_TRAINING,
    SAMPLED_PRIOR,
    Estimate,
    WalkRow,
    compare_scores,
    read_walks,
    scores,
    summarise,
)
from motorprior.studies.transfer import WALKS

CONDITIONS = ("ideal_pd", "friction_pd", "paper", SAMPLED_PRIOR, "adapted_prior")
ENVIRONMENTS = (IN_TRAINING, "fleet", "hard")
# metric -> unit in the table, factor to this unit, number format
METRICS = {
    "upright": ("upright [%]", 100.0, ".0f"),
    "speed": ("speed [m/s]", 1.0, ".2f"),
    "step_frequency": ("step frequency [Hz]", 1.0, ".2f"),
    "foot_lift_mm": ("foot lift [mm]", 1.0, ".1f"),
}
SHORT = ("paper",)  # conditions with one short training, which are not compared


@dataclass(frozen=True)
class Settings:
    """Run the demo with several seeds."""

    out: Path  # run folder
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # seeds of the demo
    options: str = ""  # further options of the demo, as in --options="--motors 12 --walks 2"


def compute(settings: Settings) -> dict[str, float]:
    """Run the demos; write and return the statistics over their benches."""
    walks: list[WalkRow] = []
    for seed in settings.seeds:
        out = settings.out / f"seed_{seed}"
        command = [sys.executable, "-m", "motorprior", "demo", "--out", str(out)]
        command += ["--seed", str(seed), *shlex.split(settings.options)]
        subprocess.run(command, check=True)
        walks += read_walks(out / WALKS)

    estimates = summarise(walks).estimates
    compared = differences(walks)
    write_text(settings.out / "table.md", tables(estimates, compared))

    figures = {}
    for (environment, condition, metric), estimate in estimates.items():
        add_estimate(figures, f"{environment}/{condition}/{metric}", estimate)
    for (environment, condition, metric), estimate in compared.items():
        name = f"minus_{SAMPLED_PRIOR}/{environment}/{condition}/{metric}"
        add_estimate(figures, name, estimate)
    return figures


def differences(walks: Sequence[WalkRow]) -> dict[tuple[str, str, str], Estimate]:
    """Each condition less the sampled prior, by environment, condition and metric."""
    compared = {}
    for environment, condition in product(ENVIRONMENTS, CONDITIONS):
        if condition == SAMPLED_PRIOR or condition in SHORT:
            continue
        of_condition = walks_of(walks, environment, condition)
        of_prior = walks_of(walks, environment, SAMPLED_PRIOR)
        for metric in METRICS:
            comparison = compare_scores(scores(of_condition, metric), scores(of_prior, metric))
            compared[environment, condition, metric] = comparison.difference
    return compared


def walks_of(walks: Sequence[WalkRow], environment: str, condition: str) -> list[WalkRow]:
    """Walks of one condition in one environment."""
    chosen = []
    for walk in walks:
        if walk["environment"] == environment and walk["condition"] == condition:
            chosen.append(walk)
    return chosen


def add_estimate(figures: dict[str, float], name: str, estimate: Estimate) -> None:
    """Add a value and its interval to the figures; they are not finite if walks are too short."""
    numbers = {
        name: estimate.value,
        f"{name}/low": estimate.low,
        f"{name}/high": estimate.high,
    }
    figures |= {key: number for key, number in numbers.items() if math.isfinite(number)}


def tables(
    estimates: dict[tuple[str, str, str], Estimate],
    compared: dict[tuple[str, str, str], Estimate],
) -> str:
    """A table per metric: means over the seeds, and differences from the sampled prior."""
    texts = []
    for metric, (title, factor, number_format) in METRICS.items():
        head = ["trained on", *ENVIRONMENTS]
        head += [
            f"{environment}, less {model_label(SAMPLED_PRIOR)}" for environment in ENVIRONMENTS
        ]
        rows = []
        for condition in CONDITIONS:
            row = [model_label(condition)]
            for table, environment in product((estimates, compared), ENVIRONMENTS):
                estimate = table.get((environment, condition, metric))
                row.append("" if estimate is None else text(estimate, factor, number_format))
            rows.append(row)
        texts.append(f"{title}\n\n{markdown(head, rows)}\n")
    return "\n".join(texts)


def text(estimate: Estimate, factor: float, number_format: str) -> str:
    """A value and its interval, which a single bench does not have."""
    numbers = [
        f"{factor * number:{number_format}}"
        for number in (estimate.value, estimate.low, estimate.high)
    ]
    if not math.isfinite(estimate.low):
        return numbers[0]
    return f"{numbers[0]} ({numbers[1]} to {numbers[2]})"


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
