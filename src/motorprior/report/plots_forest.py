"""Pictures of a study: speeds with intervals, and how many walks are faster than any speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from motorprior.report.plots_style import (
    INK,
    MUTED,
    TEXT,
    condition_color,
    describe,
    legend_below,
    model_label,
    model_line,
    new_figure,
    panels,
)
from motorprior.transfer.statistics import Estimate, profile

_COLUMNS = 2
_ROW = 0.2
"""Height of a condition [in]."""
_LONGEST = 24
"""Letters of a condition's name that fit beside a panel."""


def forest(
    twins: Mapping[str, Mapping[str, Estimate]], own: Mapping[str, Mapping[str, float]], conditions: Sequence[str]
) -> Figure:
    """A panel per twin: a row per condition, its speed with interval, hollow where it was trained.

    Args:
        twins: title -> condition -> speed [m/s].
        own: title -> condition -> speed of the same policies where they were trained [m/s].
        conditions: from top to bottom.
    """
    rows = math.ceil(len(twins) / _COLUMNS)
    figure = new_figure(rows * (_ROW * len(conditions) + 0.55) + 0.35)
    grid = panels(figure, rows, min(_COLUMNS, len(twins)), sharex=True, sharey=True)
    for axes, (title, speeds) in zip(grid.flat, twins.items(), strict=False):
        for row, condition in enumerate(conditions):
            _row(axes, row, speeds.get(condition), own[title].get(condition), condition_color(condition))
        describe(axes, title=title)
    _name_rows(grid, conditions)
    _drop_unused(grid, len(twins), "forward speed [m/s]")
    handles = [
        Line2D([], [], color=MUTED, marker="o", markersize=5, linewidth=1.6, label="on the twin, 95 % interval"),
        Line2D([], [], color=MUTED, marker="o", markersize=5, markerfacecolor="white", linewidth=0,
               label="where it was trained"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower left", ncols=2, fontsize=TEXT, frameon=False)
    return figure


def _row(axes: Axes, row: int, there: Estimate | None, own: float | None, color: str) -> None:
    if own is not None and math.isfinite(own):
        axes.plot([own], [row], "o", markersize=5, markerfacecolor="white", markeredgecolor=color, zorder=3)
    if there is not None and math.isfinite(there.value):
        axes.plot([there.low, there.high], [row, row], color=color, linewidth=1.8, solid_capstyle="butt", zorder=4)
        axes.plot([there.value], [row], "o", markersize=5, color=color, zorder=5)


def _name_rows(grid: np.ndarray, conditions: Sequence[str]) -> None:
    """Panels share their rows: names stand at the first of each line."""
    for axes in grid.flat:
        axes.set_yticks(range(len(conditions)), [short_label(each) for each in conditions])
        axes.set_ylim(len(conditions) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0, labelcolor=INK, labelsize=TEXT)
        axes.grid(False, axis="y")


def _drop_unused(grid: np.ndarray, used: int, x: str) -> None:
    """Panels beyond the last go, and the lowest of each column has the horizontal axis."""
    for place, axes in enumerate(grid.flat):
        if place >= used:
            axes.remove()
        elif place + grid.shape[1] >= used:
            axes.xaxis.set_tick_params(labelbottom=True)
            describe(axes, x=x)


def profiles(twins: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    """A panel per twin: share of the walks that are faster than a speed.

    Args:
        twins: title -> condition -> speeds of all walks [m/s].
    """
    every = np.concatenate([np.ravel(speeds) for each in twins.values() for speeds in each.values()])
    known = every[np.isfinite(every)]
    low, high = (min(0.0, float(known.min())), float(known.max())) if len(known) else (0.0, 1.0)
    thresholds = np.linspace(low, max(high, low + 0.1), 161)
    rows, conditions = math.ceil(len(twins) / _COLUMNS), {name for each in twins.values() for name in each}
    figure = new_figure(rows * 2.1 + 0.3 + 0.19 * math.ceil(len(conditions) / 3))
    grid = panels(figure, rows, min(_COLUMNS, len(twins)), sharex=True, sharey=True)
    for axes, (title, walks) in zip(grid.flat, twins.items(), strict=False):
        for condition, speeds in walks.items():
            share, color = profile(speeds, thresholds), condition_color(condition)
            model_line(axes, thresholds, share, condition, short_label(condition), color)
        axes.set(xlim=(thresholds[0], thresholds[-1]), ylim=(-0.02, 1.02))
        describe(axes, title=title)
    for axes in grid[:, 0]:
        describe(axes, y="share of walks [-]")
    _drop_unused(grid, len(twins), "faster than [m/s]")
    legend_below(figure, list(grid.flat)[: len(twins)], columns=3)
    return figure


def short_label(condition: str) -> str:
    """Its name for readers, cut where it would push the panels aside."""
    label = model_label(condition)
    return label if len(label) <= _LONGEST else f"{label[: _LONGEST - 1]}…"
