"""When a distribution over motors pays: policies on robots whose motors differ more or less.

    python benchmarks/spread_between_units.py --out runs/spread

Fleets are copies of the robot's fleet whose spread between units is SPREADS times the calibrated
one. On every bench of a fleet, a policy per condition and seed is trained as in the transfer study
(docs/transfer.md), and evaluated on held-out robots of the same fleet in the environments fleet and
hard.

Policies are trained breadth first: one in every cell of fleet, bench and condition, then a second
one. A rerun resumes, and every round writes

    figures.json    FLEET/ENVIRONMENT/CONDITION/QUANTITY, with /low and /high: mean over policies
                    with its 95 % interval for these benches; QUANTITY is upright [-] or speed
                    [m/s]; own is the simulation of the training
                    FLEET/ENVIRONMENT/CONDITION/minus_REFERENCE: difference in time upright from
                    the central motor and from the randomised PD, same bench and seed
                    FLEET/ENVIRONMENT/CONDITION/bench_SEED: time upright of the policies of a bench
                    FLEET/own/CONDITION/untrained: policies that are the untrained gait, since no
                    later one had a larger return in the evaluations of its training
    table.md        time upright and speed of all cells, and the differences
    spread.png      time upright and speed against the spread between units

About a minute and a half of two cores per policy.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from figures import PROGRESS, markdown, run_benchmark
from motorprior.actuator.distribution import Distribution
from motorprior.actuator.fleet import Fleet, load_robot_fleet, write_fleet
from motorprior.artifacts import write_json, write_text
from motorprior.locomotion.policy import Policy
from motorprior.progress import usable_threads
from motorprior.report.plots_style import (
    legend_below,
    model_label,
    model_line,
    new_figure,
    panels,
    png_bytes,
    set_labels,
)
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.training import POLICY
from motorprior.stage import FIGURES
from motorprior.studies.statistics import IN_TRAINING, LEVEL, WalkRow
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import PolicyRun, policy_runs_of, walk_table, with_selected
from motorprior.studies.transfer_models import adapt_robots, fit_models, robots_of

SPREADS = (0.0, 1.0, 2.0, 4.0)  # factors on the calibrated spread between units
CONDITIONS = (
    "central_motor",
    "random_pd",
    "sampled_prior",
    "adapted_motors",
    "adapted_prior",
    "adapted_pd",
)
REFERENCES = ("central_motor", "random_pd")
ENVIRONMENTS = ("fleet", "hard")
QUANTITIES = ("upright", "speed")
_MIN_SHARE = 0.1  # smallest value of a widened uniform range over its center [-]

Cell = tuple[str, str, str]  # fleet, environment, condition
# (bench, seed) of a policy -> mean of its walks, by quantity
PolicyMeans = dict[tuple[int, int], dict[str, float]]


@dataclass(frozen=True)
class Settings:
    """Train and evaluate the policies."""

    out: Path  # run folder
    robot: str = DEFAULT_ROBOT  # robot
    spreads: tuple[float, ...] = SPREADS  # factors on the spread between units
    conditions: tuple[str, ...] = CONDITIONS  # training conditions
    benches: int = 2  # benches of each fleet
    policies: int = 6  # policies per fleet, bench and condition
    # range of the randomised PD and share of the adapted prior; each is selected per fleet as in
    # the transfer study if not given
    pd_range: float | None = None
    prior_share: float | None = None
    motors: int = 32  # motors on a bench
    bench_steps: int = 10_000  # samples of each motor's log
    iterations: int = 120  # largest number of iterations of a training
    walks: int = 32  # walks per policy and environment
    seconds: float = 10.0  # duration of a walk [s]
    seed: int = 300  # seed of the first bench
    workers: int = 2  # policies at a time
    adam_steps: int | None = field(default=None)  # of each identification; its preset's if None


def fleets_of(settings: Settings, robot: Robot) -> dict[str, Fleet]:
    """The fleets by name."""
    base = load_robot_fleet(robot)
    fleets = {}
    for spread in settings.spreads:
        parameters = {name: scaled(value, spread) for name, value in base.parameters.items()}
        name = f"spread_{spread:g}"
        fleets[name] = replace(base, name=name, parameters=parameters)
    return fleets


def scaled(distribution: Distribution, factor: float) -> Distribution:
    """The distribution with ``factor`` times the spread between units.

    A uniform range is scaled about its center; its lower end stays above _MIN_SHARE of the center.
    The uncertainty of the center, which all motors of a robot share, stays.
    """
    values = dict(distribution.values)
    if distribution.form == "uniform":
        center = distribution.center
        half = 0.5 * factor * (values["high"] - values["low"])
        values["low"] = max(center - half, _MIN_SHARE * center)
        values["high"] = center + half
    elif distribution.form != "constant":
        values["spread"] = factor * values["spread"]
    return Distribution(distribution.form, values)


def studies_of(settings: Settings) -> dict[str, Study]:
    """The transfer study of every fleet, whose file is written."""
    robot = load_robot(settings.robot)
    studies = {}
    for name, fleet in fleets_of(settings, robot).items():
        path = settings.out / "fleets" / f"{name}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        sources = dict.fromkeys(fleet.parameters, "the robot's fleet, changed")
        write_fleet(path, fleet, sources, f"copy of a fleet by {Path(__file__).name}: {name}")
        studies[name] = Study(
            settings.out / name,
            fleet=str(path),
            conditions=settings.conditions,
            environments=ENVIRONMENTS,
            benches=settings.benches,
            seeds=settings.policies,
            walks=settings.walks,
            seconds=settings.seconds,
            iterations=settings.iterations,
            pd_range=settings.pd_range,
            prior_share=settings.prior_share,
            motors=settings.motors,
            bench_steps=settings.bench_steps,
            adam_steps=settings.adam_steps,
            seed=settings.seed,
            robot=settings.robot,
            workers=settings.workers,
        )
    return studies


def compute(settings: Settings) -> dict[str, float]:
    """Train and evaluate policies breadth first; write the results after every round."""
    studies = studies_of(settings)
    threads = usable_threads(settings.workers, PROGRESS)
    walks: defaultdict[str, list[WalkRow]] = defaultdict(list)
    untrained: Counter[tuple[str, str]] = Counter()
    figures: dict[str, float] = {}
    for seed, bench_number in product(range(settings.policies), range(settings.benches)):
        for name, study in studies.items():
            bench = study.of_benches()[bench_number]
            fit_models([bench], threads, PROGRESS)
            selected = with_selected(study, threads, PROGRESS)
            bench = selected.of_benches()[bench_number]
            robots = [robot for robot in robots_of(bench) if robot[-1] == seed]
            adapt_robots(robots, threads, PROGRESS)

            runs = policy_runs_of(bench, seed)
            walks[name] += walk_table(selected, runs, PROGRESS)
            untrained.update((name, run.name) for run in runs if is_untrained(bench, run))
            figures = summary(walks)
            for (fleet, condition), count in untrained.items():
                figures[f"{fleet}/{IN_TRAINING}/{condition}/untrained"] = count
            write_json(settings.out / FIGURES, figures)
            write_text(settings.out / "table.md", table(figures, settings))
            (settings.out / "spread.png").write_bytes(picture(figures, settings))
    return figures


def is_untrained(bench: Study, run: PolicyRun) -> bool:
    """Whether the best policy of a training is the one before its first iteration."""
    policy = Policy.load(bench.out / "policies" / run.folder / POLICY)
    return policy.provenance["iteration"] == 0


def summary(walks: Mapping[str, Sequence[WalkRow]]) -> dict[str, float]:
    """Means over policies with their intervals, and differences from the REFERENCES."""
    figures: dict[str, float] = {}
    cells = policy_means(walks)
    for (fleet, environment, condition), policies in cells.items():
        cell = f"{fleet}/{environment}/{condition}"
        figures[f"{cell}/policies"] = len(policies)
        for quantity in QUANTITIES:
            values = {policy: means[quantity] for policy, means in policies.items()}
            bounds = (0.0, 1.0) if quantity == "upright" else (-np.inf, np.inf)
            add_interval(figures, f"{cell}/{quantity}", values, bounds)

        for bench, values in by_bench(upright_of(policies)).items():
            figures[f"{cell}/bench_{bench}"] = float(np.mean(values))

        for reference in REFERENCES:
            others = cells.get((fleet, environment, reference), {})
            if reference == condition or not others:
                continue
            differences = {}
            for policy in policies.keys() & others.keys():
                differences[policy] = policies[policy]["upright"] - others[policy]["upright"]
            add_interval(figures, f"{cell}/minus_{reference}", differences)
    return figures


def upright_of(policies: PolicyMeans) -> dict[tuple[int, int], float]:
    """Time upright of every policy [-]."""
    return {policy: means["upright"] for policy, means in policies.items()}


def policy_means(walks: Mapping[str, Sequence[WalkRow]]) -> dict[Cell, PolicyMeans]:
    """Means over the walks of every policy, by cell."""
    rows_of_policies: defaultdict[tuple[Cell, tuple[int, int]], list[WalkRow]] = defaultdict(list)
    for fleet, rows in walks.items():
        for row in rows:
            cell = (fleet, row["environment"], row["condition"])
            rows_of_policies[cell, (row["bench"], row["seed"])].append(row)

    cells: defaultdict[Cell, PolicyMeans] = defaultdict(dict)
    for (cell, policy), rows in rows_of_policies.items():
        means = {name: float(np.nanmean([row[name] for row in rows])) for name in QUANTITIES}
        cells[cell][policy] = means
    return dict(cells)


def by_bench(values: Mapping[tuple[int, int], float]) -> dict[int, np.ndarray]:
    """Values of policies (bench, seed), by bench."""
    of_benches: defaultdict[int, list[float]] = defaultdict(list)
    for (bench, _), value in sorted(values.items()):
        of_benches[bench].append(value)
    return {bench: np.array(of_bench) for bench, of_bench in of_benches.items()}


def add_interval(
    figures: dict[str, float],
    name: str,
    values: Mapping[tuple[int, int], float],
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> None:
    """Add the mean over benches, and the ends of its interval if benches have several policies.

    The benches are strata: with B of them, n_b policies each and their variance s_b², the variance
    of the mean of the benches' means is Σ s_b²/n_b / B², and Student's t has Σ (n_b - 1) degrees of
    freedom. The interval is about these benches; two are too few for one over benches. ``bounds``
    are those of a mean.
    """
    benches = list(by_bench(values).values())
    mean = float(np.mean([of_bench.mean() for of_bench in benches]))
    figures[name] = mean
    if min(len(of_bench) for of_bench in benches) < 2:
        return

    variances = [of_bench.var(ddof=1) / len(of_bench) for of_bench in benches]
    error = np.sqrt(np.sum(variances)) / len(benches)
    freedom = sum(len(of_bench) - 1 for of_bench in benches)
    reach = float(stdtrit(freedom, 0.5 * (1.0 + LEVEL)) * error)
    figures[f"{name}/low"] = max(mean - reach, bounds[0])
    figures[f"{name}/high"] = min(mean + reach, bounds[1])


def table(figures: Mapping[str, float], settings: Settings) -> str:
    """Two tables, a row per fleet and condition: time upright and speed; differences."""
    head = ["motors of a robot", "trained on", "policies", "own, upright [%]"]
    head += [f"{environment}, upright [%]" for environment in ENVIRONMENTS]
    head += ["hard, each bench"]
    head += [f"{environment}, speed [m/s]" for environment in ENVIRONMENTS]
    head_of_differences = ["motors of a robot", "trained on"]
    for environment, reference in product(ENVIRONMENTS, REFERENCES):
        head_of_differences.append(f"{environment}, less {model_label(reference)} [points]")

    rows = []
    rows_of_differences = []
    fleets = dict.fromkeys(name.split("/")[0] for name in figures)
    for fleet, condition in product(fleets, settings.conditions):
        cells = {
            environment: f"{fleet}/{environment}/{condition}"
            for environment in (IN_TRAINING, *ENVIRONMENTS)
        }
        own = cells[IN_TRAINING]
        if f"{own}/policies" not in figures:
            continue
        policies = f"{figures[f'{own}/policies']:.0f}"
        if figures.get(f"{own}/untrained"):
            policies += f", {figures[f'{own}/untrained']:.0f} untrained"
        row = [fleet, model_label(condition), policies]
        row.append(text(figures, f"{own}/upright", 100.0, ".0f"))
        row += [text(figures, f"{cells[env]}/upright", 100.0, ".0f") for env in ENVIRONMENTS]
        of_benches = [
            f"{100.0 * value:.0f}"
            for name, value in figures.items()
            if name.startswith(f"{cells['hard']}/bench_")
        ]
        row.append(" / ".join(of_benches))
        row += [text(figures, f"{cells[env]}/speed", 1.0, ".2f") for env in ENVIRONMENTS]
        rows.append(row)

        row_of_differences = [fleet, model_label(condition)]
        for environment, reference in product(ENVIRONMENTS, REFERENCES):
            name = f"{cells[environment]}/minus_{reference}"
            known = name in figures
            row_of_differences.append(text(figures, name, 100.0, ".0f") if known else "")
        rows_of_differences.append(row_of_differences)
    return f"{markdown(head, rows)}\n\n{markdown(head_of_differences, rows_of_differences)}\n"


def text(figures: Mapping[str, float], name: str, factor: float, number_format: str) -> str:
    """A figure and its interval."""
    value = f"{factor * figures[name]:{number_format}}"
    if f"{name}/low" not in figures:
        return value
    low = factor * figures[f"{name}/low"]
    high = factor * figures[f"{name}/high"]
    return f"{value} ({low:{number_format}} to {high:{number_format}})"


def picture(figures: Mapping[str, float], settings: Settings) -> bytes:
    """Time upright and speed against the spread between units, with intervals."""
    figure = new_figure(4.6)
    grid = panels(figure, len(QUANTITIES), len(ENVIRONMENTS), sharex=True, sharey="row")
    labels = {"upright": "time upright [-]", "speed": "speed [m/s]"}
    spreads = sorted(settings.spreads)
    for (row, quantity), (column, environment) in product(
        enumerate(QUANTITIES), enumerate(ENVIRONMENTS)
    ):
        axes = grid[row, column]
        for number, condition in enumerate(settings.conditions):
            cells = [
                f"spread_{spread:g}/{environment}/{condition}/{quantity}" for spread in spreads
            ]
            values = np.array([figures.get(cell, np.nan) for cell in cells])
            low = np.array([figures.get(f"{cell}/low", np.nan) for cell in cells])
            high = np.array([figures.get(f"{cell}/high", np.nan) for cell in cells])
            # beside each other, so that intervals do not hide each other
            x = np.array(spreads) + 0.06 * (number - 0.5 * len(settings.conditions))
            line = model_line(axes, x, values, condition)
            line.set_marker("o")
            line.set_markersize(3.0)
            axes.vlines(x, low, high, color=line.get_color(), linewidth=0.8)
        is_last = row == len(QUANTITIES) - 1
        set_labels(
            axes,
            x="spread between units over the calibrated one [-]" if is_last else None,
            y=labels[quantity] if column == 0 else None,
            title=environment if row == 0 else None,
        )
    legend_below(figure, grid[0, 0], columns=3)
    return png_bytes(figure)


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
