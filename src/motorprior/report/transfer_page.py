"""The page of the transfer study: training simulations, held-out robots, differences."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.page import Section, Table, page, picture
from motorprior.report.plots_style import model_color, model_label, new_figure, panels, set_labels
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY
from motorprior.studies.statistics import (
    ALL_ENVIRONMENTS,
    CONVERGED,
    IN_TRAINING,
    IN_TRAINING_OUT_OF_FAMILY,
    ConditionKey,
    Estimate,
    StudyStatistics,
)
from motorprior.studies.study_settings import CONDITIONS


class _Format(NamedTuple):
    """How a metric is written in tables."""

    title: str
    factor: float  # factor from the unit of the metric to the unit in the title
    number_format: str


METRICS = {
    "upright": _Format("time upright [%]", 100.0, "z.0f"),
    "speed": _Format("speed [m/s]", 1.0, "z.2f"),
}
# how the robots step, see `gait_quality.walk_metrics`
STEPS = {
    "step_frequency": _Format("steps of each leg per second [Hz]", 1.0, ".2f"),
    "foot_lift_mm": _Format("foot lift [mm]", 1.0, ".1f"),
}


def transfer_page(summary: StudyStatistics, settings: Mapping[str, Any], command: str) -> str:
    """The page as HTML; it names the ``command`` that made it."""
    return page("Transfer study", study_sections(summary), settings, command)


def study_sections(summary: StudyStatistics) -> list[Section]:
    """Training simulations, results on held-out robots, and differences from the sampled prior."""
    sections = [own_simulations(summary), _held_out_robots(summary)]
    if summary.differences:
        sections.append(_differences(summary))
    return sections


def own_simulations(summary: StudyStatistics) -> Section:
    """Time upright of every policy in the simulation of its training.

    The table has a row per training condition and a cell per bench; policies below CONVERGED are
    marked.
    """
    rows = []
    not_converged = []
    for condition in conditions_in(summary):
        for env in (IN_TRAINING, IN_TRAINING_OUT_OF_FAMILY):
            policies = summary.upright.get((env, condition))  # (benches, policies)
            if policies is None:
                continue
            name = model_label(condition)
            if env == IN_TRAINING_OUT_OF_FAMILY:
                name = f"{name}, out-of-family motors"
            cells = []
            for policies_of_bench in policies:
                cells.append(" ".join(_marked(value) for value in policies_of_bench))
            rows.append((condition if env == IN_TRAINING else name, *cells))

            count = int(np.sum(policies < CONVERGED))
            if count:
                not_converged.append(f"{count} of {policies.size} of {name}")

    columns = ("trained on", *(f"bench {bench}" for bench in summary.benches))
    caption = "time upright of every policy in the simulation of its training [%]"
    text = (
        "The simulation of a training has the motors of its condition, sensor noise and pushes. A "
        "policy that falls there has not converged, or its motors cannot walk so fast."
    )
    policies_below = "; ".join(not_converged) or "no policy"
    counts = f"Upright for less than {100 * CONVERGED:.0f} % (marked *): {policies_below}."
    return Section(
        "In the simulation of the training",
        (text, counts),
        tables=(Table(columns, rows, caption),),
    )


def _marked(upright: float) -> str:
    """Time upright of a policy [%], with a mark if it is below CONVERGED."""
    return f"{100.0 * upright:.0f}" + ("*" if upright < CONVERGED else "")


def _held_out_robots(summary: StudyStatistics) -> Section:
    text = (
        "One policy is trained per bench, motor model and seed, and evaluated on held-out robots; "
        "an adapted policy is evaluated on the robot it was adapted to. The tables show means over "
        "benches with 95 % intervals."
    )
    caption = (
        "Time upright: mean over benches with 95 % interval; small dots: the policies; hollow: in "
        "the training simulation of the condition."
    )
    drawn = picture(forest_plot(summary), caption)
    tables = tuple(estimate_table(summary, metric) for metric in METRICS)
    return Section("Held-out robots", (text,), (drawn,), tables)


def _differences(summary: StudyStatistics) -> Section:
    text = (
        "p: permutation tests within benches, corrected by Holm for all differences. A single "
        "bench has no p."
    )
    tables = tuple(difference_table(summary, metric) for metric in METRICS)
    return Section("Differences from the sampled prior", (text,), tables=tables)


def conditions_in(summary: StudyStatistics) -> list[str]:
    """Training conditions in the order of every table."""
    names = {condition for _, condition in summary.upright}
    standard = [name for name in CONDITIONS if name in names]
    return standard + sorted(names - set(CONDITIONS))


def estimate_table(summary: StudyStatistics, metric: str) -> Table:
    """A row per training condition, a cell per environment: the mean over benches, its interval."""
    title, factor, number_format = (METRICS | STEPS)[metric]
    cells = {}
    for (env, condition, name), estimate in summary.estimates.items():
        if name == metric:
            cells[env, condition] = with_interval(estimate, factor, number_format)
    return _table(summary, ALL_ENVIRONMENTS, cells, f"{title}, mean [95 % interval]")


def difference_table(summary: StudyStatistics, metric: str) -> Table:
    """A row per training condition, a cell per environment: the difference from the sampled prior.

    Conditions without any difference have no row.
    """
    title, factor, number_format = METRICS[metric]
    cells = {}
    for (env, condition, name), comparison in summary.differences.items():
        if name == metric:
            difference = with_interval(comparison.difference, factor, f"+{number_format}")
            is_tested = np.isfinite(comparison.p)
            cells[env, condition] = difference + (f" p={comparison.p:.2g}" if is_tested else "")
    caption = f"{title}: difference from the sampled prior [95 % interval]"
    table = _table(summary, ENVIRONMENTS, cells, caption)
    rows = [row for row in table.rows if any(row[1:])]
    return Table(table.columns, rows, caption)


def _table(
    summary: StudyStatistics, order: Iterable[str], cells: Mapping[ConditionKey, str], caption: str
) -> Table:
    """A row per training condition, a column per environment in this order."""
    evaluated = {env for env, _ in summary.upright}
    envs = [env for env in order if env in evaluated]
    rows = []
    for condition in conditions_in(summary):
        rows.append((condition, *(cells.get((env, condition), "") for env in envs)))
    return Table(("trained on", *envs), rows, caption)


def with_interval(estimate: Estimate, factor: float, number_format: str) -> str:
    """Text of the value times ``factor`` and, if it is defined, of its interval."""
    value = f"{factor * estimate.value:{number_format}}"
    if not np.isfinite(estimate.low):
        return value
    low = f"{factor * estimate.low:{number_format}}"
    high = f"{factor * estimate.high:{number_format}}"
    return f"{value} [{low}, {high}]"


def forest_plot(summary: StudyStatistics) -> Figure:
    """Time upright: a panel per environment, a row per training condition.

    Hollow marks are the time upright in the training simulation.
    """
    conditions = conditions_in(summary)
    evaluated = {env for env, _, metric in summary.estimates if metric == "upright"}
    environments = [env for env in ENVIRONMENTS if env in evaluated] or [IN_TRAINING]

    figure = new_figure(0.28 * len(conditions) + 0.9)
    grid = panels(figure, 1, len(environments), sharex=True, sharey=True)[0]
    for axes, env in zip(grid, environments, strict=True):
        _draw_environment(axes, summary, env, conditions)
    left, _ = grid[0].get_xlim()
    grid[0].set_xlim(min(0.5, left), 1.03)
    return figure


def _draw_environment(
    axes: Axes, summary: StudyStatistics, env: str, conditions: Sequence[str]
) -> None:
    """The panel of an environment."""
    upright = {}  # environment, condition -> time upright
    for (name, condition, metric), estimate in summary.estimates.items():
        if metric == "upright":
            upright[name, condition] = estimate
    is_out_of_family = env in ENVIRONMENTS and ENVIRONMENTS[env].population == OUT_OF_FAMILY
    training_env = IN_TRAINING_OUT_OF_FAMILY if is_out_of_family else IN_TRAINING

    for row, condition in enumerate(conditions):
        color = model_color(condition)
        policies = summary.upright.get((env, condition), np.empty(0)).ravel()
        axes.plot(policies, np.full(len(policies), row + 0.2), ".", markersize=3, color=color)

        in_training = upright.get((training_env, condition))
        if in_training is None:  # the policies are the same for both populations
            in_training = upright.get((IN_TRAINING, condition))
        if in_training is not None:
            (mark,) = axes.plot([in_training.value], [row], "o", markersize=5)
            mark.set_markerfacecolor("white")
            mark.set_markeredgecolor(color)

        held_out = upright.get((env, condition))
        if held_out is not None:
            axes.plot([held_out.low, held_out.high], [row, row], color=color, linewidth=1.8)
            axes.plot([held_out.value], [row], "o", markersize=5, color=color)

    labels = [model_label(condition) for condition in conditions]
    axes.set_yticks(range(len(conditions)), labels)
    axes.set_ylim(len(conditions) - 0.5, -0.5)
    set_labels(axes, x="time upright [-]", title=env)
