"""Quantile-quantile plots of behaviour features: motors of a prior against physical motors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_style import (
    INK,
    MUTED,
    TEXT,
    describe,
    legend_below,
    model_color,
    model_label,
    new_figure,
    panels,
)

_COLUMNS = 4
_LEVELS = np.linspace(0.01, 0.99, 99)
_BAND = (0.05, 0.95)
_BAND_COLOR = "#cfd4da"
_RESAMPLES = 400
_ROOM = 1.0
"""Margin of the axes beyond one sample's span, in spans; values further out are drawn on the edge."""


def feature_quantiles(
    names: Sequence[str],
    units: Sequence[str],
    a: np.ndarray,
    b: np.ndarray,
    label_a: str,
    label_b: str,
    seed: int = 0,
) -> Figure:
    """Quantiles (1 to 99 %) of each feature of ``a`` over those of ``b``, with the identity and a 90 % band.

    On the identity: equal distributions. Shifted from it: a bias. Flatter or steeper: too little or too much spread.
    The band contains each quantile with 90 % probability if both samples came from b's distribution (b resampled with
    replacement twice, in a's and in b's size). A cross on the edge marks a value beyond the axes.

    Args:
        names: F features.
        units: F units.
        a: (n, F), the vertical axis, such as prior draws; ``label_a`` may be a key of MODEL_COLORS.
        b: (m, F), the horizontal axis, such as held-out physical motors.
        label_a: what a is.
        label_b: what b is.
        seed: of the resampling.
    """
    rows = -(-len(names) // _COLUMNS)
    figure = new_figure(2.15 * rows + 0.5, width=8.8)
    grid = panels(figure, rows, _COLUMNS)
    rng = np.random.default_rng(seed)
    for index, axes in enumerate(grid.flat):
        if index >= len(names):
            axes.set_axis_off()
            continue
        _quantile_panel(axes, a[:, index], b[:, index], label_a, rng)
        described = f"{names[index]} [{units[index]}]"
        axes.set_title(described, loc="left", fontsize=TEXT, fontweight="bold", color=INK, pad=4)
    for row in range(rows):
        describe(grid[row, 0], y=model_label(label_a))
    for column in range(min(_COLUMNS, len(names))):
        lowest = (len(names) - 1 - column) // _COLUMNS
        describe(grid[lowest, column], x=model_label(label_b))
    legend_below(figure, max(grid.flat, key=lambda axes: len(axes.get_legend_handles_labels()[0])))
    return figure


def _quantile_panel(axes: Axes, a: np.ndarray, b: np.ndarray, label: str, rng: np.random.Generator) -> None:
    """One feature (n,), (m,): band, identity, quantiles; both axes with the same limits."""
    x, y = np.quantile(b, _LEVELS), np.quantile(a, _LEVELS)
    low, high = _limits(x, y)
    below, above = null_band(b, len(a), rng)
    axes.fill_between(x, below, above, color=_BAND_COLOR, linewidth=0, label="90 % of samples of equal distributions")
    axes.plot([low, high], [low, high], color=MUTED, linewidth=0.8, label="equal")
    inside = (y >= low) & (y <= high)
    color = model_color(label)
    look = {"color": color, "linestyle": "none", "clip_on": False, "zorder": 3}
    axes.plot(x[inside], y[inside], marker="o", markersize=2.2, label="quantiles, 1 to 99 %", markeredgewidth=0, **look)
    if not inside.all():
        edge = np.clip(y[~inside], low, high)
        axes.plot(x[~inside], edge, marker="x", markersize=3.0, label="beyond the picture", **look)
    axes.set(xlim=(low, high), ylim=(low, high), box_aspect=1.0)
    axes.locator_params(nbins=4)


def _limits(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Both samples' quantiles, a's no further than _ROOM spans of b's (but at least whole where b has none)."""
    span = max(float(np.ptp(x)), 0.1 * float(np.ptp(y)), 1e-3 * float(np.abs(x).max()), 1e-9)
    center_gap = abs(float(np.median(y) - np.median(x)))
    room = max(_ROOM * span, center_gap)
    low = max(float(min(x[0], y[0])), float(x[0]) - room)
    high = min(float(max(x[-1], y[-1])), float(x[-1]) + room)
    margin = 0.04 * max(high - low, span)
    return low - margin, high + margin


def null_band(b: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound (99,) of the quantiles of ``count`` motors of b's distribution, b (m,) being a sample."""
    ours = np.quantile(rng.choice(b, (_RESAMPLES, count)), _LEVELS, axis=1)
    theirs = np.quantile(rng.choice(b, (_RESAMPLES, len(b))), _LEVELS, axis=1)
    gap = np.quantile(ours - theirs, _BAND, axis=1)
    middle = np.quantile(b, _LEVELS)
    return middle + gap[0], middle + gap[1]
