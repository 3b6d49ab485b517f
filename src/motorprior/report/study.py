"""Sections of the pages of the transfer study and of the demo: tables, a forest plot, robustness."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_style import (
    TEXT,
    describe,
    model_color,
    model_label,
    new_figure,
    panels,
)
from motorprior.studies import statistics
from motorprior.studies.compare import FRICTIONS, PUSHES
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY
from motorprior.studies.statistics import OWN, OWN_OUT_OF_FAMILY, Estimate, StudyStatistics
from motorprior.studies.study_settings import CONDITIONS
from motorprior.studies.transfer import LOG_SECONDS

BASELINES = ("ideal_pd", "friction_pd", "random_pd", "paper")
_EXPLAINED = {
    "fleet": "other robots of the same fleet",
    "hard": "other motors, floor, load, delays and pushes",
}
# a baseline whose time upright is less by no more is called as good as the prior [-]
_EQUAL_UPRIGHT = 0.02


def study_sections(summary: StudyStatistics) -> list[Section]:
    """Own simulations, speed and time upright of all conditions, and their differences from the sampled prior."""
    text = (
        "One policy is trained per bench, motor model and seed, and evaluated on held-out robots, an adapted one on "
        "its own: means over benches with 95 % intervals."
    )
    drawn = picture(
        forest_plot(summary),
        "Time upright: mean over benches with 95 % interval; points: the benches; hollow: in the training simulation.",
    )
    tables = tuple(measure_table(summary, measure) for measure in MEASURES)
    sections = [own_simulations(summary), Section("Held-out robots", (text,), (drawn,), tables)]
    tables = tuple(difference_table(summary, measure) for measure in MEASURES)
    text = "Permutation tests within benches; p corrected by Holm for all differences."
    tests = Section("Differences from the sampled prior", (text,), tables=tables)
    return [*sections, tests] if summary.differences else sections


def conditions_in(summary: StudyStatistics) -> list[str]:
    """Training conditions in the order of every table."""
    found = {condition for _, condition in summary.upright}
    order = tuple(CONDITIONS)
    return [name for name in order if name in found] + sorted(found - set(order))


def own_simulations(summary: StudyStatistics) -> Section:
    """Time upright of every policy in the simulation of its training: a row per condition, a cell per bench."""
    text = "A policy that falls in the simulation of its training has not converged, or its motors cannot walk so fast."
    rows = []
    failed = []
    for condition in conditions_in(summary):
        for env in (OWN, OWN_OUT_OF_FAMILY):
            if (policies := summary.upright.get((env, condition))) is not None:
                cells = (" ".join(f"{100.0 * value:.0f}" for value in bench) for bench in policies)
                rows.append(
                    (condition if env == OWN else f"{condition}, out-of-family motors", *cells)
                )
                if count := int(np.sum(policies < statistics.CONVERGED)):
                    failed.append(f"{count} of {policies.size} of {rows[-1][0]}")
    caption = "time upright of every policy in the simulation of its training [%]"
    table = Table(("trained on", *(f"bench {bench}" for bench in summary.benches)), rows, caption)
    counts = f"Upright for less than {100 * statistics.CONVERGED:.0f} %: {'; '.join(failed) or 'no policy'}."
    return Section("In the simulation of the training", (text, counts), tables=(table,))


# title, factor, format
MEASURES = {"upright": ("time upright [%]", 100.0, ".0f"), "speed": ("speed [m/s]", 1.0, ".2f")}


def measure_table(summary: StudyStatistics, measure: str) -> Table:
    """A row per condition, a cell per environment: the mean over benches with its interval."""
    title, factor, form = MEASURES[measure]
    cells = {
        (env, condition): with_interval(found, factor, form)
        for (env, condition, kind), found in summary.estimates.items()
        if kind == measure
    }
    return _table(summary, statistics.ALL_ENVIRONMENTS, cells, f"{title}, mean [95 % interval]")


def _table(
    summary: StudyStatistics,
    order: Iterable[str],
    cells: Mapping[tuple[str, str], str],
    caption: str,
) -> Table:
    """A row per condition, a column per environment in this order."""
    envs = [env for env in order if env in {env for env, _ in summary.upright}]
    rows = [
        (name, *(cells.get((env, name), "") for env in envs)) for name in conditions_in(summary)
    ]
    return Table(("trained on", *envs), rows, caption)


def difference_table(summary: StudyStatistics, measure: str) -> Table:
    """A row per condition, the difference from the sampled prior per environment."""
    title, factor, form = MEASURES[measure]
    cells = {
        (env, condition): f"{with_interval(found.difference, factor, f'+{form}')} p={found.p:.2g}"
        for (env, condition, kind), found in summary.differences.items()
        if kind == measure
    }
    found = _table(
        summary,
        ENVIRONMENTS,
        cells,
        f"{title}, minus that of the sampled prior [95 % interval], and p",
    )
    return replace(found, rows=[row for row in found.rows if any(row[1:])])


def with_interval(found: Estimate, factor: float, form: str) -> str:
    """The value times ``factor`` and, if it is defined, its interval."""
    ends = (
        f" [{factor * found.low:{form}}, {factor * found.high:{form}}]"
        if np.isfinite(found.low)
        else ""
    )
    return f"{factor * found.value:{form}}{ends}"


def forest_plot(summary: StudyStatistics) -> Figure:
    """Time upright, a panel per environment and a row per condition, hollow in the training simulation."""
    conditions = conditions_in(summary)
    upright = {
        (env, name): each
        for (env, name, kind), each in summary.estimates.items()
        if kind == "upright"
    }
    environments = [env for env in ENVIRONMENTS if env in {env for env, _ in upright}] or [OWN]
    figure = new_figure(0.28 * len(conditions) + 0.9)
    of_other_motors = {
        env for env, each in ENVIRONMENTS.items() if each.population == OUT_OF_FAMILY
    }
    of_environments = panels(figure, 1, len(environments), sharex=True, sharey=True)[0]
    for axes, environment in zip(of_environments, environments, strict=True):
        trained_in = OWN_OUT_OF_FAMILY if environment in of_other_motors else OWN
        for row, condition in enumerate(conditions):
            color = model_color(condition)
            benches = summary.by_bench.get((environment, condition, "upright"), np.empty(0))
            axes.plot(benches, np.full(len(benches), row + 0.2), ".", markersize=3, color=color)
            if (
                own := upright.get((trained_in, condition), upright.get((OWN, condition)))
            ) is not None:
                axes.plot(
                    [own.value],
                    [row],
                    "o",
                    markersize=5,
                    markerfacecolor="white",
                    markeredgecolor=color,
                )
            if (other := upright.get((environment, condition))) is not None:
                axes.plot([other.low, other.high], [row, row], color=color, linewidth=1.8)
                axes.plot([other.value], [row], "o", markersize=5, color=color)
        axes.set_yticks(
            range(len(conditions)), [model_label(condition) for condition in conditions]
        )
        axes.set_ylim(len(conditions) - 0.5, -0.5)
        describe(axes, x="time upright [-]", title=environment)
    of_environments[0].set_xlim(min(0.5, of_environments[0].get_xlim()[0]), 1.03)
    return figure


def results_section(summary: StudyStatistics, speed: float, film: Picture) -> Section:
    """Question, result and uncertainty; the film; time upright and speed."""
    policies = max(each.shape[1] for each in summary.upright.values())
    asked = (
        f"Policies are trained in simulation on models of a robot's motors, and then walk robots that they have never "
        f"seen, commanded {speed:g} m/s: {'; '.join(f'{env}: {text}' for env, text in _EXPLAINED.items())}."
    )
    uncertainty = (
        f"95 % intervals over the robots, of at most {policies} policies per condition, all for one bench of motors. "
        "Intervals exclude variation between trainings and benches; those of the study include it (docs/transfer.md)."
    )
    drawn = picture(forest_plot(summary), "Time upright; hollow: in the training simulation.")
    tables = tuple(measure_table(summary, measure) for measure in MEASURES)
    return Section(
        "Results", (headline(summary), asked, _gaps(summary), uncertainty), (drawn, film), tables
    )


def _gaps(summary: StudyStatistics) -> str:
    """Time upright lost between the training simulation and held-out robots of the fleet, by condition."""
    upright = {
        key[:2]: each.value for key, each in summary.estimates.items() if key[2] == "upright"
    }
    lost = {name: upright[OWN, name] - upright["fleet", name] for name in conditions_in(summary)}
    gaps = [f"{model_label(name)} {100 * value:+.0f}" for name, value in lost.items()]
    return f"Transfer gap, own simulation minus fleet, in percentage points upright: {', '.join(gaps)}."


def headline(summary: StudyStatistics) -> str:
    """Time upright on held-out robots; starts with a baseline that is as good as the prior, if any."""

    def upright(name: str) -> np.ndarray:
        return np.array([summary.estimates[env, name, "upright"].value for env in _EXPLAINED])

    def percent(name: str) -> str:
        values = zip(_EXPLAINED, upright(name), strict=True)
        return " and ".join(f"{100 * value:.0f} % ({env})" for env, value in values)

    best = max(BASELINES, key=lambda name: upright(name).sum())
    equal = np.all(upright(best) > upright(statistics.REFERENCE) - _EQUAL_UPRIGHT)
    first = (
        f"Here a simpler model is as good as the learned prior: the {model_label(best)}. "
        if equal
        else ""
    )
    return (
        f"{first}Time upright on held-out robots: {percent(statistics.REFERENCE)} after training on samples of the "
        f"prior; {percent('adapted_prior')} on the prior adapted to {LOG_SECONDS:g} s of log of the robot; "
        f"{percent('ideal_pd')} on an ideal PD; {percent(best)} on the best baseline, the {model_label(best)}."
    )


def robustness(maps: Mapping[str, np.ndarray]) -> Section:
    """Condition -> (pushes, frictions) time upright [-], on one scale."""
    text = "Held-out robots of the fleet with stronger pushes and other floors than in any training, walks of 5 s."
    caption = "Time upright [%], over all policies."
    return Section("Robustness on held-out robots", (text,), (picture(_heat_maps(maps), caption),))


def _heat_maps(maps: Mapping[str, np.ndarray]) -> Figure:
    figure = new_figure(2.6)
    for column, (axes, (name, values)) in enumerate(
        zip(panels(figure, 1, len(maps), sharey=True)[0], maps.items(), strict=True)
    ):
        axes.imshow(values, vmin=0.0, vmax=1.0, cmap="Blues", origin="lower", aspect="auto")
        axes.grid(False)
        for row, line in enumerate(values):
            for at, value in enumerate(line):
                ink = "white" if value > 0.6 else "black"
                axes.text(
                    at,
                    row,
                    f"{100 * value:.0f}",
                    ha="center",
                    va="center",
                    fontsize=TEXT,
                    color=ink,
                )
        axes.set_xticks(range(len(FRICTIONS)), [f"{each:g}" for each in FRICTIONS])
        axes.set_yticks(range(len(PUSHES)), [f"{each:g}" for each in PUSHES])
        y = "largest push [N·s]" if column == 0 else None
        describe(axes, x="friction of the floor [-]", y=y, title=model_label(name))
    return figure
