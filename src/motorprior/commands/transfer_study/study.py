"""The transfer study: policies trained on each model of a bench's motors, evaluated on held-out robots.

1. Record a bench of motors; fit the models to it.
2. Select the range of the randomised PD on a fleet that no test environment uses.
3. Adapt the prior and a PD to ten seconds of log of each robot.
4. Train a policy per condition and seed; evaluate it in its training simulation and in four environments.
5. Summarise: interquartile mean speed and mean time upright with 95 % intervals; differences from the sampled prior
   with permutation p-values, corrected by Holm.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.artifacts import write_json, write_text
from motorprior.commands.transfer_study.conditions import ADAPTED, adapt_robots, conditions, fit_models, fitted_pd
from motorprior.commands.transfer_study.settings import CONDITIONS, OWN_MOTORS, Study
from motorprior.commands.transfer_study.walk_table import OWN, OWN_FOREIGN, WalkTable
from motorprior.commands.transfer_study.walks import WALKS, walk_table
from motorprior.progress import SILENT, Progress, usable_threads
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.stage import PAGE, locked, write_results
from motorprior.studies import statistics
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY

if TYPE_CHECKING:
    from motorprior.report.page import Table

MEASURES = {  # measure -> unit, see `walk_measures`; the lift of each foot is foot_lift_mm/LEG
    "speed": "m/s", "upright": "1", "distance": "m", "heading_deg_per_m": "°/m", "lateral_share": "1", "drift": "m",
    "slip": "m/m", "transport": "1", "torque_beyond": "1", "step_frequency": "Hz", "foot_lift_mm": "mm",
    "body_rate": "rad/s",
}  # fmt: skip
COMPARED = ("speed", "upright")
REFERENCE = "prior"
PD_RANGES = (0.1, 0.2, 0.3, 0.4)  # of the randomised PD, to select from
PD_RANGE_SEEDS = range(900, 903)  # used by no condition
TABLES, SPREADS = "tables.md", "spreads.json"


@dataclass(frozen=True)
class Summary:
    """Statistics of a table of walks.

    Attributes:
        estimates: (environment, condition, measure) -> interquartile mean, of ``upright`` the mean, with 95 % interval.
        upright: (environment, condition) -> share of the policies that are upright for at least 90 % of the time.
        differences: (environment, condition, measure) -> condition compared with the sampled prior.
        p: the same keys -> p, corrected for all of these comparisons.
    """

    estimates: dict[tuple[str, str, str], statistics.Estimate]
    upright: dict[tuple[str, str], float]
    differences: dict[tuple[str, str, str], statistics.Comparison]
    p: dict[tuple[str, str, str], float]


def run_study(config: Study, progress: Progress = SILENT, command: str = "") -> Summary:
    """Run every stage that is not finished; write walks.csv, results.json, figures.json, tables.md and report.html.

    Raises:
        MotorPriorError: invalid settings, or a failed stage; finished stages stay.
    """
    config = config.sized()
    robot = load_robot(config.robot)
    with locked(config.out):
        threads = usable_threads(config.workers, progress)
        config = config if config.ray_address else replace(config, workers=threads)
        fit_models(config, threads, progress)
        config = with_pd_range(config, progress)
        adapt_robots(config, threads, progress)
        cells = [(condition, seed) for seed in range(config.seeds) for condition in conditions(config, seed)]
        table = walk_table(config, cells, progress)
        table.save(config.out / WALKS)
        summary = summarise(table)
        write_results(config.out, as_results(summary))
        settings = asdict(config) | {"speed": config.commanded(robot)}
        settings |= {"validation": config.validation_fleet(robot) or OWN_MOTORS}
        for name in ("out", "workers", "executor", "ray_address"):  # the result does not depend on them
            del settings[name]
        write_page(config.out, summary, {name: str(value) for name, value in settings.items()}, command)
    return summary


def with_pd_range(config: Study, progress: Progress) -> Study:
    """The study with the range of its randomised PD whose policies are upright for longest on the validation fleet."""
    if config.spread is not None or "pd_randomised" not in config.conditions:
        return config
    robot = load_robot(config.robot)
    fleet = config.range_fleet(robot)
    made = {spread: fitted_pd(config, "pd_friction", f"pd_randomised_{spread:g}", spread) for spread in PD_RANGES}
    tried = [replace(condition, environments=(OUT_OF_FAMILY,)) for condition in made.values()]
    selected_on = config.validation_fleet(robot) or OWN_MOTORS
    search = replace(config, out=config.out / "spreads", foreign=str(fleet), validation=selected_on)
    seeds = PD_RANGE_SEEDS[: config.seeds]
    table = walk_table(search, [(condition, seed) for seed in seeds for condition in tried], progress)
    found = {
        spread: {
            measure: statistics.estimate(
                table.scores(OUT_OF_FAMILY, condition.name, measure), statistic_of(measure)
            ).value
            for measure in COMPARED
        }
        for spread, condition in made.items()
    }
    best = max(found, key=lambda spread: (found[spread]["upright"], found[spread]["speed"]))
    by_range = {f"{spread:g}": walked for spread, walked in found.items()}
    write_json(search.out / SPREADS, {"fleet": fleet, "tried": by_range, "chosen": best})
    progress.note(f"range of the randomised PD, selected on the fleet {fleet!r}: {best:g}")
    return replace(config, spread=best)


def statistic_of(measure: str) -> statistics.Statistic:
    """Mean of the time upright (an interquartile mean would hide falls); interquartile mean otherwise."""
    return statistics.means if measure == "upright" else statistics.iqms


def summarise(table: WalkTable) -> Summary:
    """Statistics of all walks."""
    estimates, upright, differences = {}, {}, {}
    for place in table.distinct("place"):
        for condition in table.at(place).distinct("condition"):
            cell = table.at(place, condition)
            for measure in cell.measures():
                scores = cell.scores(place, condition, measure)
                if np.isfinite(scores).any():
                    estimates[place, condition, measure] = statistics.estimate(scores, statistic_of(measure))
            per_policy = cell.scores(place, condition, "upright").mean(axis=1)
            upright[place, condition] = float(np.mean(per_policy >= 0.9))
            trained = condition not in (REFERENCE, "untrained") and place in ENVIRONMENTS
            if trained and len(table.at(place, REFERENCE)):
                for measure in COMPARED:
                    differences[place, condition, measure] = compare(table, place, condition, REFERENCE, measure)
    return Summary(estimates, upright, differences, statistics.holm({key: each.p for key, each in differences.items()}))


def compare(table: WalkTable, place: str, one: str, other: str, measure: str) -> statistics.Comparison:
    """One condition compared with another in an environment, on the same walks, or on the robots that both walked."""
    mine, theirs, statistic = table.at(place, one), table.at(place, other), statistic_of(measure)
    scores = mine.scores(place, one, measure), theirs.scores(place, other, measure)
    if one in ADAPTED and other in ADAPTED:
        return statistics.compare_pairs(*scores, statistic)
    if one in ADAPTED:  # the policy of seed k walks robot k, as does draw k of the others
        robots = sorted(set(mine.distinct("seed")) & set(theirs.distinct("draw")))
        mine = WalkTable.of(walk for walk in mine.walks if walk.seed in robots)
        theirs = WalkTable.of(walk for walk in theirs.walks if walk.draw in robots)
        return statistics.compare_on_robots(
            mine.scores(place, one, measure), theirs.scores(place, other, measure), statistic
        )
    return statistics.compare_scores(
        *scores, shared=mine.distinct("draw") == theirs.distinct("draw"), statistic=statistic
    )


def as_results(summary: Summary) -> Results:
    """Rows PLACE/CONDITION/MEASURE with /low and /high, PLACE/CONDITION/policies_upright, MEASURE_p_against_prior."""
    rows = []
    for (place, condition, measure), found in summary.estimates.items():
        unit = MEASURES.get(measure, MEASURES["foot_lift_mm"])
        ends = {None: found.value, "low": found.low, "high": found.high}
        name = f"{place}/{condition}/{measure}"
        rows += [Result(name, unit, value, statistic=end) for end, value in ends.items() if np.isfinite(value)]
    for (place, condition), share in summary.upright.items():
        rows.append(Result(f"{place}/{condition}/policies_upright", "1", share))
    for (place, condition, measure), p in summary.p.items():
        rows.append(Result(f"{place}/{condition}/{measure}_p_against_{REFERENCE}", "1", p))
    return Results.of(rows)


def write_page(out: Path, summary: Summary, settings: dict[str, str], command: str) -> None:
    """Write report.html and tables.md."""
    from motorprior.report.page import Section, page, picture  # here: they import matplotlib
    from motorprior.report.plots_study import forest_plot

    headline, differences = headline_table(summary), difference_table(summary)
    text = (
        "One policy is trained per motor model and seed, and evaluated on held-out robots: speed [m/s] and time "
        "upright [%] with 95 % intervals, and the share of policies that are upright for 90 % of the time.",
    )
    upright = {(place, name): each for (place, name, kind), each in summary.estimates.items() if kind == "upright"}
    drawn = picture(forest_plot(upright, _conditions(summary)), "Time upright; hollow: in the training simulation.")
    sections = [Section("Speed and time upright", text, (drawn,), (headline,))]
    if differences.rows:
        text = ("Differences from the sampled prior; p corrected by Holm for all of them.",)
        sections.append(Section("Differences from the sampled prior", text, tables=(differences,)))
    write_text(out / PAGE, page("Transfer study", sections, settings, command))
    write_text(out / TABLES, f"{_markdown(headline)}\n\n{_markdown(differences)}\n")


def _environments(summary: Summary) -> list[str]:
    found = {place for place, _, _ in summary.estimates}
    return [place for place in (OWN, OWN_FOREIGN, *ENVIRONMENTS) if place in found]


def _conditions(summary: Summary) -> list[str]:
    found = {condition for _, condition, _ in summary.estimates}
    return [name for name in CONDITIONS if name in found]


def headline_table(summary: Summary) -> Table:
    """A row per condition, a cell per environment."""
    from motorprior.report.page import Table

    rows = []
    for condition in _conditions(summary):
        cells = []
        for place in _environments(summary):
            speed, upright = (summary.estimates.get((place, condition, measure)) for measure in COMPARED)
            if speed is None or upright is None:
                cells.append("")
                continue
            share = 100.0 * summary.upright[place, condition]
            cells.append(f"{_interval(speed, 1.0, '.2f')}; {_interval(upright, 100.0, '.0f')}; {share:.0f}")
        rows.append((condition, *cells))
    caption = "speed [low, high]; time upright [%] [low, high]; policies upright for 90 % of the time [%]"
    return Table(("trained on", *_environments(summary)), tuple(rows), caption)


def difference_table(summary: Summary) -> Table:
    """A row per condition, the difference from the sampled prior per environment."""
    from motorprior.report.page import Table

    places = [place for place in _environments(summary) if place in ENVIRONMENTS]
    rows = []
    for condition in _conditions(summary):
        cells = []
        for place in places:
            keys = [(place, condition, measure) for measure in COMPARED]
            compared = [(summary.differences[key], summary.p[key]) for key in keys if key in summary.p]
            forms = zip(compared, (1.0, 100.0), ("+.2f", "+.0f"), strict=False)
            texts = [f"{_interval(each.difference, factor, form)} p={p:.2g}" for (each, p), factor, form in forms]
            cells.append("; ".join(texts))
        if any(cells):
            rows.append((condition, *cells))
    caption = "speed [m/s] [low, high]; time upright [percentage points] [low, high]"
    return Table(("trained on", *places), tuple(rows), caption)


def _interval(found: statistics.Estimate, factor: float, form: str) -> str:
    ends = f" [{factor * found.low:{form}}, {factor * found.high:{form}}]" if np.isfinite(found.low) else ""
    return f"{factor * found.value:{form}}{ends}"


def _markdown(table: Table) -> str:
    lines = [table.columns, ("---",) * len(table.columns), *table.rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines) + f"\n\n{table.caption}"
