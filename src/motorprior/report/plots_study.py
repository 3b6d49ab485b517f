"""Pictures of the whole study: learning, fidelity, transfer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from motorprior.report.plots_style import (
    INK,
    MUTED,
    TEXT,
    condition_color,
    describe,
    distinct_colors,
    legend_below,
    model_color,
    model_label,
    model_line,
    new_figure,
    panels,
    two_digits,
)

Curve = tuple[np.ndarray, np.ndarray]


def learning_curves(curves: Mapping[str, Sequence[Curve]]) -> Figure:
    """Return of the policy while it learns: the median of the seeds, and every seed thin.

    Args:
        curves: per condition one (iteration (N,) [-], mean return (N,) [m]) for each seed.
    """
    figure = new_figure(3.5)
    (axes,) = panels(figure, 1)[0]
    colors = distinct_colors(curves)
    for condition, seeds in curves.items():
        for iteration, mean_return in seeds:
            axes.plot(iteration, mean_return, color=colors[condition], linewidth=0.6, alpha=0.4)
        grid, middle = _median(seeds)
        label = f"{model_label(condition)}, {len(seeds)} seed" + "s" * (len(seeds) != 1)
        model_line(axes, grid, middle, condition, label, colors[condition]).set_linewidth(2.0)
    describe(axes, x="ARS iteration [-]", y="mean return [m]", title="Learning to walk")
    legend_below(figure, axes, columns=3)
    return figure


def _median(seeds: Sequence[Curve]) -> Curve:
    """Median over the seeds where all of them have values."""
    start = max(iteration[0] for iteration, _ in seeds)
    stop = min(iteration[-1] for iteration, _ in seeds)
    grid = np.unique(np.concatenate([iteration for iteration, _ in seeds]))
    grid = grid[(grid >= start) & (grid <= stop)]
    return grid, np.median([np.interp(grid, *seed) for seed in seeds], axis=0)


def fidelity_bars(table: Mapping[str, Mapping[str, float]]) -> Figure:
    """Errors of every model, grouped by metric, on a logarithmic axis; lower is better.

    Metrics of one unit, read from the ``[...]`` at the end of their names, share a panel.

    Args:
        table: per metric ("closed loop, steps [rad]") the value of each model. A value that is
            not finite is printed as a word.
    """
    units: dict[str, list[str]] = {}
    for metric in table:
        units.setdefault(_name_and_unit(metric)[1], []).append(metric)
    models = list(dict.fromkeys(model for row in table.values() for model in row))
    figure = new_figure(2.75 * max(len(units), 1) + 0.3)
    grid = panels(figure, max(len(units), 1))[:, 0]
    for axes, (unit, metrics) in zip(grid, units.items(), strict=False):
        _bar_groups(axes, {metric: table[metric] for metric in metrics}, models)
        describe(axes, y=f"error [{unit}]")
    describe(grid[0], title="Fidelity, lower is better")
    handles = [Patch(color=model_color(model), label=model_label(model)) for model in models]
    figure.legend(handles=handles, loc="outside lower left", ncols=5, fontsize=TEXT, frameon=False)
    return figure


def _name_and_unit(metric: str) -> tuple[str, str]:
    """("closed loop", "rad") of "closed loop [rad]"."""
    name, bracket, unit = metric.rstrip("]").rpartition("[")
    return (name.strip(), unit) if bracket else (metric, "-")


def _bar_groups(axes: Axes, table: Mapping[str, Mapping[str, float]], models: list[str]) -> None:
    """One group per metric, one bar per model."""
    finite = [value for row in table.values() for value in row.values() if math.isfinite(value) and value > 0]
    floor, top = (min(finite) / 2.0, max(finite) * 2.0) if finite else (0.1, 1.0)
    width = 0.84 / max(len(models), 1)
    turned = len(table) * len(models) > 14
    for group, row in enumerate(table.values()):
        for place, model in enumerate(models):
            x = group + (place - (len(models) - 1) / 2) * width
            if model in row:
                _bar(axes, x, 0.92 * width, row[model], floor, model, turned)
    axes.set_yscale("log")
    axes.set_ylim(floor, top)
    axes.set_xlim(-0.5, len(table) - 0.5)
    axes.set_xticks(range(len(table)), [_wrapped(_name_and_unit(metric)[0]) for metric in table])
    axes.tick_params(axis="x", length=0, labelcolor=INK, labelsize=TEXT)
    axes.grid(False, axis="x")


def _bar(axes: Axes, x: float, width: float, value: float, floor: float, model: str, turned: bool) -> None:
    """A bar with its value on top, turned where bars are thin; what a logarithm cannot show is said."""
    usable = math.isfinite(value) and value > 0
    if usable:
        axes.bar(x, value - floor, width, bottom=floor, color=model_color(model), linewidth=0)
    text = two_digits(value) if usable or value == 0 else "diverged"
    look = {
        "ha": "center",
        "va": "bottom",
        "fontsize": TEXT - 2,
        "rotation": 90 if turned or not usable else 0,
    }
    color = MUTED if usable else model_color(model)
    at = (x, value if usable else floor)
    axes.annotate(text, at, xytext=(0, 2), textcoords="offset points", color=color, **look)


def _wrapped(text: str) -> str:
    """Two lines or more where a label is longer than 18 letters."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) >= 18:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)


def transfer_bars(own: Mapping[str, tuple[float, float]], twin: Mapping[str, tuple[float, float]]) -> Figure:
    """Every policy in the simulation it was trained in and on the twin, the held-out virtual robot.

    Args:
        own: (speed [m/s], share of time upright [-]) per condition, in its own simulation.
        twin: the same on the twin.
    """
    conditions = list(dict.fromkeys([*own, *twin]))
    figure = new_figure(0.62 * max(len(conditions), 2) + 0.9)
    speed, upright = panels(figure, 1, 2, sharey=True)[0]
    for column, axes in enumerate((speed, upright)):
        for place, condition in enumerate(conditions):
            _pair(axes, place, condition, own.get(condition), twin.get(condition), column)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0, labelcolor=INK, labelsize=TEXT + 0.5)
        axes.axvline(0.0, color=MUTED, linewidth=0.8)
    speed.set_yticks(range(len(conditions)), [model_label(condition) for condition in conditions])
    speed.set_ylim(len(conditions) - 0.5, -0.5)
    speed.margins(x=0.16)
    upright.set(xlim=(0.0, 1.18), xticks=(0, 0.25, 0.5, 0.75, 1.0))
    describe(speed, x="forward speed [m/s]", y="trained on")
    describe(upright, x="share of time upright [-]")
    handles = [Patch(color=_pale(MUTED)), Patch(color=MUTED)]
    labels = ["pale: the simulation it was trained in", "full: the twin, held-out motors"]
    figure.legend(handles, labels, loc="outside lower left", ncols=2, fontsize=TEXT, frameon=False)
    return figure


def _pair(
    axes: Axes,
    place: int,
    condition: str,
    own: tuple[float, float] | None,
    twin: tuple[float, float] | None,
    column: int,
) -> None:
    """The two bars of one condition, each with its value."""
    full = model_color(condition)
    for offset, values, color in ((-0.19, own, _pale(full)), (0.19, twin, full)):
        if values is None or not math.isfinite(values[column]):
            continue
        value = values[column]
        axes.barh(place + offset, value, 0.34, color=color, linewidth=0)
        look = {"xytext": (3, 0), "textcoords": "offset points", "va": "center", "fontsize": TEXT - 1}
        text = f"{value:.2f}".replace("-", "−")
        ink = INK if color == full else MUTED
        axes.annotate(text, (max(value, 0.0), place + offset), color=ink, **look)


def _pale(color: str) -> tuple[float, float, float]:
    """The colour at a third of its strength on white, opaque."""
    red, green, blue = to_rgb(color)
    return 1 - 0.36 * (1 - red), 1 - 0.36 * (1 - green), 1 - 0.36 * (1 - blue)


def forest(upright: Mapping[tuple[str, str], Any], conditions: Sequence[str]) -> Figure:
    """Time upright, a panel per environment and a row per condition, hollow in the training simulation.

    Args:
        upright: (place, condition) -> estimate with value, low and high; place "own" is the training simulation.
        conditions: from top to bottom.
    """
    places = list(dict.fromkeys(place for place, _ in upright if not place.startswith("own"))) or ["own"]
    figure = new_figure(0.24 * len(conditions) + 0.9)
    for axes, place in zip(panels(figure, 1, len(places), sharey=True)[0], places, strict=True):
        for row, condition in enumerate(conditions):
            color = condition_color(condition)
            if (own := upright.get(("own", condition))) is not None:
                axes.plot([own.value], [row], "o", markersize=5, markerfacecolor="white", markeredgecolor=color)
            if (there := upright.get((place, condition))) is not None:
                axes.plot([there.low, there.high], [row, row], color=color, linewidth=1.8)
                axes.plot([there.value], [row], "o", markersize=5, color=color)
        axes.set_yticks(range(len(conditions)), [model_label(condition) for condition in conditions])
        axes.set(xlim=(-0.05, 1.05), ylim=(len(conditions) - 0.5, -0.5))
        describe(axes, x="time upright [-]", title=place)
    return figure
