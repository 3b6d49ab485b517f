"""Behaviour features of samples of a motor prior compared with those of physical motors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_style import MUTED, describe, legend_below, model_color, model_label, new_figure, panels

LEVELS = np.linspace(0.01, 0.99, 99)


def feature_quantiles(
    names: Sequence[str], units: Sequence[str], a: np.ndarray, b: np.ndarray, label_a: str, label_b: str, seed: int = 0
) -> Figure:
    """Q-Q plots: quantiles (1 to 99 %) of each feature of ``a`` over those of ``b``, with the identity and a 90 % band.

    Args:
        names: F features.
        units: F units.
        a: (n, F), such as samples of a prior.
        b: (m, F), such as held-out physical motors.
        label_a: name of a.
        label_b: name of b.
        seed: of the resampling, see `null_band`.
    """
    rows = -(-len(names) // 4)
    figure = new_figure(2.15 * rows + 0.5, width=8.8)
    grid = panels(figure, rows, 4)
    rng = np.random.default_rng(seed)
    for index, (name, unit) in enumerate(zip(names, units, strict=True)):
        axes = grid.flat[index]
        _quantile_panel(axes, a[:, index], b[:, index], label_a, rng)
        describe(axes, x=model_label(label_b), y=model_label(label_a), title=f"{name} [{unit}]")
    for axes in grid.flat[len(names) :]:
        axes.remove()
    legend_below(figure, grid[0, 0])
    return figure


def _quantile_panel(axes: Axes, a: np.ndarray, b: np.ndarray, label: str, rng: np.random.Generator) -> None:
    """One feature (n,), (m,); values of ``a`` far outside the range of ``b`` are cut off."""
    x, y = np.quantile(b, LEVELS), np.quantile(a, LEVELS)
    below, above = null_band(b, len(a), rng)
    extent = max(float(np.ptp(x)), 1e-9)
    margin = max(extent, abs(float(np.median(y) - np.median(x))))
    low, high = max(min(x[0], y[0]), x[0] - margin), min(max(x[-1], y[-1]), x[-1] + margin)
    axes.fill_between(x, below, above, color="#cfd4da", lw=0, label="90 % of samples of equal distributions")
    axes.plot([low, high], [low, high], color=MUTED, lw=0.8, label="equal")
    axes.plot(x, y, "o", color=model_color(label), markersize=2.2, label="quantiles, 1 to 99 %")
    margin = 0.04 * max(high - low, extent)
    axes.set(xlim=(low - margin, high + margin), ylim=(low - margin, high + margin), box_aspect=1.0)


def null_band(b: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (99,) of 90 % of the quantiles of ``count`` motors of b's distribution.

    The sample b (m,) is resampled with replacement 400 times in each of the two sizes.
    """
    ours = np.quantile(rng.choice(b, (400, count)), LEVELS, axis=1)
    theirs = np.quantile(rng.choice(b, (400, len(b))), LEVELS, axis=1)
    gap = np.quantile(ours - theirs, (0.05, 0.95), axis=1)
    middle = np.quantile(b, LEVELS)
    return middle + gap[0], middle + gap[1]
