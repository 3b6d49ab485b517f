"""Page of the transfer study: tables and a forest plot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.page import Section, Table, picture
from motorprior.report.plots_style import describe, model_color, model_label, new_figure, panels
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.statistics import Estimate
from motorprior.studies.summary import (
    COMPARED,
    CONDITIONS,
    CONVERGED,
    FROZEN,
    OWN,
    OWN_FOREIGN,
    PLACES,
    Summary,
)


def study_sections(summary: Summary) -> list[Section]:
    """Own simulations, speed and time upright of all conditions, and their differences from the sampled prior."""
    differences = difference_table(summary)
    text = (
        "One policy is trained per bench, motor model and seed, and evaluated on held-out robots: speed [m/s] and time "
        "upright [%], means over benches with 95 % intervals, and the share of policies that are upright for 90 % of "
        "the time."
    )
    drawn = picture(
        forest_plot(summary, conditions_in(summary)),
        "Time upright: mean over benches with 95 % interval; points: the benches; hollow: in the training simulation.",
    )
    sections = [
        own_simulations(summary),
        Section("Speed and time upright on held-out robots", (text,), (drawn,), (headline_table(summary),)),
    ]
    if differences.rows:
        text = "Differences from the sampled prior; p corrected by Holm for all of them."
        sections.append(Section("Differences from the sampled prior", (text,), tables=(differences,)))
    return sections


def conditions_in(summary: Summary) -> list[str]:
    """Training conditions in the order of every table."""
    found, order = {condition for _, condition in summary.upright}, (*CONDITIONS, *FROZEN)
    return [name for name in order if name in found] + sorted(found - set(order))


def own_simulations(summary: Summary) -> Section:
    """Time upright of every policy in the simulation of its training."""
    text = "A policy that falls in the simulation of its training has not converged, or its motors cannot walk so fast."
    return Section("In the simulation of the training", (text,), tables=(own_table(summary),))


def own_table(summary: Summary) -> Table:
    """A row per condition, a cell per bench: time upright of every policy in the simulation of its training."""
    rows = []
    for condition in conditions_in(summary):
        for place in (OWN, OWN_FOREIGN):
            if (policies := summary.upright.get((place, condition))) is not None:
                cells = (" ".join(f"{100.0 * value:.0f}" for value in bench) for bench in policies)
                rows.append((condition if place == OWN else f"{condition}, out-of-family motors", *cells))
    caption = "time upright of every policy in the simulation of its training [%]"
    return Table(("trained on", *(f"bench {bench}" for bench in summary.benches)), rows, caption)


def headline_table(summary: Summary) -> Table:
    """A row per condition, a cell per environment."""
    places = [place for place in PLACES if place in {place for place, _ in summary.upright}]

    def cell(place: str, condition: str) -> str:
        if (place, condition) not in summary.upright:
            return ""
        speed, upright = (summary.estimates[place, condition, measure] for measure in COMPARED)
        share = 100.0 * float(np.mean(summary.upright[place, condition] >= CONVERGED))
        return f"{with_interval(speed, 1.0, '.2f')}; {with_interval(upright, 100.0, '.0f')}; {share:.0f}"

    rows = [(condition, *(cell(place, condition) for place in places)) for condition in conditions_in(summary)]
    caption = "speed [low, high]; time upright [%] [low, high]; policies upright for 90 % of the time [%]"
    return Table(("trained on", *places), rows, caption)


def difference_table(summary: Summary) -> Table:
    """A row per condition, the difference from the sampled prior per environment."""
    places = [place for place in ENVIRONMENTS if place in {place for place, _ in summary.upright}]

    def cell(place: str, condition: str) -> str:
        texts = []
        for measure, factor, form in (("speed", 1.0, "+.2f"), ("upright", 100.0, "+.0f")):
            if (found := summary.differences.get((place, condition, measure))) is not None:
                texts.append(f"{with_interval(found.difference, factor, form)} p={found.p:.2g}")
        return "; ".join(texts)

    rows = [(condition, *(cell(place, condition) for place in places)) for condition in conditions_in(summary)]
    caption = "speed [m/s] [low, high]; time upright [percentage points] [low, high]"
    return Table(("trained on", *places), [row for row in rows if any(row[1:])], caption)


def with_interval(found: Estimate, factor: float, form: str) -> str:
    """The value times ``factor`` and, if it is defined, its interval."""
    ends = f" [{factor * found.low:{form}}, {factor * found.high:{form}}]" if np.isfinite(found.low) else ""
    return f"{factor * found.value:{form}}{ends}"


def forest_plot(summary: Summary, conditions: Sequence[str]) -> Figure:
    """Time upright, a panel per environment and a row per condition, hollow in the training simulation."""
    upright = {(place, name): each for (place, name, kind), each in summary.estimates.items() if kind == "upright"}
    environments = [place for place in ENVIRONMENTS if place in {place for place, _ in upright}] or [OWN]
    figure = new_figure(0.28 * len(conditions) + 0.9)
    for axes, environment in zip(panels(figure, 1, len(environments), sharey=True)[0], environments, strict=True):
        for row, condition in enumerate(conditions):
            color = model_color(condition)
            benches = summary.by_bench.get((environment, condition, "upright"), np.empty(0))
            axes.plot(benches, np.full(len(benches), row + 0.2), ".", markersize=3, color=color)
            if (own := upright.get((OWN, condition))) is not None:
                axes.plot([own.value], [row], "o", markersize=5, markerfacecolor="white", markeredgecolor=color)
            if (other := upright.get((environment, condition))) is not None:
                axes.plot([other.low, other.high], [row, row], color=color, linewidth=1.8)
                axes.plot([other.value], [row], "o", markersize=5, color=color)
        axes.set_yticks(range(len(conditions)), [model_label(condition) for condition in conditions])
        axes.set(xlim=(-0.05, 1.05), ylim=(len(conditions) - 0.5, -0.5))
        describe(axes, x="time upright [-]", title=environment)
    return figure
