"""Pictures of real motors: how far models are from each, what two of them did, and their constants beside a fleet's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_style import (
    FAINT,
    INK,
    MUTED,
    TIME,
    describe,
    fit_y,
    legend_below,
    model_color,
    new_figure,
    panels,
    style,
    target_line,
)
from motorprior.report.real_motor_tables import NAMES, Trace
from motorprior.signals import rmse

LONGEST = 8.0
"""Shown of a trace, from its end, where a chirp is fastest [s]."""
LOWEST = 0.05
"""Shown of constants [times the fleet's median]; a delay may be almost nothing, of which an arrow tells."""
_LOOKS = {
    "ideal_pd": ("ideal_pd", "s"), "tuned_pd": ("tuned_pd", "D"), "prior": ("rollout", "o"),
    "prior_mean": ("rollout", "|"), "pure_delay": ("paper_wide", "x"), "second_order": ("tuned_pd", "D"),
    "servo_limits": ("one_network", "o"), "physical": ("rollout", "o"), "physical_draws": ("rollout", "|"),
}  # fmt: skip
"""Whose colour a model has, and its mark."""


def errors_by_joint(errors: Mapping[str, Mapping[str, float]]) -> Figure:
    """A line per joint, on it a mark per model.

    Args:
        errors: model -> joint -> RMSE [rad].
    """
    joints = list(dict.fromkeys(joint for values in errors.values() for joint in values))
    figure = new_figure(1.1 + 0.23 * len(joints))
    axes = figure.add_subplot()
    style(axes)
    for model, values in errors.items():
        color, mark = _LOOKS[model]
        rows = [joints.index(joint) for joint in values]
        milli = [1e3 * value for value in values.values()]
        look = {"markersize": 9 if mark == "|" else 5, "markeredgewidth": 1.6 if mark in "|x" else 0.5}
        axes.plot(milli, rows, mark, color=model_color(color), label=NAMES[model], **look)
    axes.set_xscale("log")
    _plain_numbers(axes)
    axes.set_yticks(range(len(joints)), joints)
    axes.set_ylim(len(joints) - 0.5, -0.5)
    describe(axes, x="RMSE of the angle, command in and motion out [mrad]")
    legend_below(figure, axes, columns=3)
    return figure


def traces(shown: Sequence[Trace]) -> Figure:
    """A row per trace: what a joint did beside simulations, then their error; the last seconds."""
    figure = new_figure(0.7 + 1.9 * len(shown))
    grid = panels(figure, len(shown), 2)
    for (angle, error), trace in zip(grid, shown, strict=True):
        _draw(angle, error, trace)
    for axes in grid[-1]:
        describe(axes, x=TIME)
    legend_below(figure, grid[:, 0], columns=3)
    figure.align_ylabels()
    return figure


def _draw(angle: Axes, error: Axes, trace: Trace) -> None:
    part = trace.time >= trace.time[-1] - LONGEST
    time, measured = trace.time[part], trace.measured[part]
    target_line(angle, time, trace.target[part]).set_linewidth(0.7)
    angle.plot(time, measured, color=INK, linewidth=1.9, label="recorded")
    simulated = {name: trace.models[name][part] for name in NAMES if name in trace.models}
    for model, values in simulated.items():
        color = model_color(_LOOKS[model][0])
        angle.plot(time, values, color=color, linewidth=1.1, label=NAMES[model])
        error.plot(time, 1e3 * (values - measured), color=color, linewidth=0.9)
    fit_y(angle, [measured, trace.target[part]], list(simulated.values()))
    best = min(simulated.values(), key=lambda values: float(rmse(values, measured)))
    fit_y(error, [1e3 * (best - measured)], [1e3 * (values - measured) for values in simulated.values()], margin=3.0)
    describe(angle, y="angle [rad]", title=f"{trace.joint}, {trace.log}")
    describe(error, y="minus recorded [mrad]")


def constants_beside_fleet(
    motors: Mapping[str, Sequence[float]], fleet: Mapping[str, tuple[float, float, float]], name: str
) -> Figure:
    """A line per constant: a dot per motor, over the median of the fleet, whose 90 % are a bar.

    Args:
        motors: constant -> its values.
        fleet: constant -> 5 %, median and 95 % of the fleet's draws; constants without are left out.
        name: of the fleet.
    """
    shown = [constant for constant in motors if constant in fleet]
    figure = new_figure(1.1 + 0.27 * len(shown))
    axes = figure.add_subplot()
    style(axes)
    for row, constant in enumerate(shown):
        low, middle, high = fleet[constant]
        values, first = np.array(motors[constant]) / middle, row == 0
        lost = values < LOWEST
        look = {"linewidth": 9, "solid_capstyle": "butt", "color": FAINT}
        axes.plot([low / middle, high / middle], [row, row], label=f"90 % of fleet {name}" if first else None, **look)
        look = {"markersize": 4, "alpha": 0.6, "color": model_color("rollout")}
        axes.plot(values[~lost], np.full((~lost).sum(), row), "o", label="your motors" if first else None, **look)
        if lost.any():
            axes.plot([LOWEST], [row], marker="<", clip_on=False, **look)
            text = {"xytext": (7, 0), "textcoords": "offset points", "va": "center", "fontsize": 7, "color": MUTED}
            axes.annotate(f"{lost.sum()} below {LOWEST:g}", (LOWEST, row), **text)
    axes.set_xscale("log")
    axes.set_xlim(left=max(axes.get_xlim()[0], LOWEST))
    axes.axvline(1.0, color=MUTED, linewidth=0.8, zorder=0)
    _plain_numbers(axes)
    axes.set_yticks(range(len(shown)), [constant.replace("_", " ") for constant in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    describe(axes, x="times the fleet's median")
    legend_below(figure, axes)
    return figure


def _plain_numbers(axes: Axes) -> None:
    """A logarithmic axis with 1, 2, 5, 10 in place of powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
