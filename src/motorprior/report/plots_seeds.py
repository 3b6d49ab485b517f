"""Several seeds of one training: median, quartiles and range over the iterations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.plots_style import MODEL_COLORS, describe, legend_below, new_figure, panels


def seed_curves(iteration: np.ndarray, curves: Mapping[str, np.ndarray]) -> Figure:
    """A panel per quantity.

    Args:
        iteration: (N,) of the search.
        curves: name with unit -> (seeds, N) values.
    """
    figure = new_figure(2.0 * len(curves) + 0.6)
    grid, color = panels(figure, len(curves), sharex=True)[:, 0], MODEL_COLORS["rollout"]
    for axes, (title, values) in zip(grid, curves.items(), strict=True):
        low, middle, high = np.percentile(values, [25.0, 50.0, 75.0], axis=0)
        least, most = values.min(axis=0), values.max(axis=0)
        axes.fill_between(iteration, least, most, color=color, alpha=0.12, linewidth=0, label="all seeds")
        axes.fill_between(iteration, low, high, color=color, alpha=0.3, linewidth=0, label="quartiles")
        axes.plot(iteration, middle, color=color, linewidth=1.8, label="median")
        describe(axes, y=title)
    count = len(next(iter(curves.values())))
    describe(grid[0], title=f"Learning to walk, {count} seed{'s' * (count != 1)}")
    describe(grid[-1], x="iteration [-]")
    legend_below(figure, grid, columns=3)
    figure.align_ylabels()
    return figure
