"""Forest plot of the transfer study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from motorprior.report.plots_style import describe, model_color, model_label, new_figure, panels


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
            color = model_color(condition)
            if (own := upright.get(("own", condition))) is not None:
                axes.plot([own.value], [row], "o", markersize=5, markerfacecolor="white", markeredgecolor=color)
            if (there := upright.get((place, condition))) is not None:
                axes.plot([there.low, there.high], [row, row], color=color, linewidth=1.8)
                axes.plot([there.value], [row], "o", markersize=5, color=color)
        axes.set_yticks(range(len(conditions)), [model_label(condition) for condition in conditions])
        axes.set(xlim=(-0.05, 1.05), ylim=(len(conditions) - 0.5, -0.5))
        describe(axes, x="time upright [-]", title=place)
    return figure
