"""Forest plot of the transfer study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from motorprior.report.plots_style import describe, model_color, model_label, new_figure, panels


def forest_plot(upright: Mapping[tuple[str, str], Any], conditions: Sequence[str]) -> Figure:
    """Time upright, a panel per environment and a row per condition, hollow in the training simulation.

    Args:
        upright: (environment, condition) -> estimate with value, low and high; "own" is the training simulation.
        conditions: from top to bottom.
    """
    environments = list(dict.fromkeys(name for name, _ in upright if not name.startswith("own"))) or ["own"]
    figure = new_figure(0.24 * len(conditions) + 0.9)
    for axes, environment in zip(panels(figure, 1, len(environments), sharey=True)[0], environments, strict=True):
        for row, condition in enumerate(conditions):
            color = model_color(condition)
            if (own := upright.get(("own", condition))) is not None:
                axes.plot([own.value], [row], "o", markersize=5, markerfacecolor="white", markeredgecolor=color)
            if (other := upright.get((environment, condition))) is not None:
                axes.plot([other.low, other.high], [row, row], color=color, linewidth=1.8)
                axes.plot([other.value], [row], "o", markersize=5, color=color)
        axes.set_yticks(range(len(conditions)), [model_label(condition) for condition in conditions])
        axes.set(xlim=(-0.05, 1.05), ylim=(len(conditions) - 0.5, -0.5))
        describe(axes, x="time upright [-]", title=environment)
    return figure
