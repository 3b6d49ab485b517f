"""Gait diagrams: a row per leg, a bar where its foot is on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_style import INK, MUTED, TEXT, describe, new_figure, panels
from motorprior.signals import runs_of_true


def footfalls(
    stances: Mapping[str, np.ndarray], legs: Sequence[str], span: float, axis: str, *, color: str = INK
) -> Figure:
    """A panel per pattern, all over the same span.

    Args:
        stances: title -> (S, legs) whether each foot is on the ground, at S times evenly over the span.
        legs: their names.
        span: of the horizontal axis.
        axis: what that is, with its unit.
        color: of the bars.
    """
    figure = new_figure(0.62 + len(stances) * (0.2 * len(legs) + 0.38))
    grid = panels(figure, len(stances), sharex=True)[:, 0]
    for axes, (title, stance) in zip(grid, stances.items(), strict=True):
        _bars(axes, stance, span, color)
        axes.set_yticks(range(len(legs)), legs)
        axes.set(xlim=(0.0, span), ylim=(len(legs) - 0.4, -0.6))
        axes.tick_params(axis="y", length=0, labelcolor=INK, labelsize=TEXT)
        axes.grid(False, axis="y")
        share = " / ".join(f"{100.0 * each:.0f}" for each in stance.mean(axis=0))
        axes.annotate(
            f"on the ground {share} %", (1.0, 1.0), xytext=(0, 4), xycoords="axes fraction",
            textcoords="offset points", ha="right", va="bottom", fontsize=TEXT - 1, color=MUTED,
        )  # fmt: skip
        describe(axes, title=title)
    describe(grid[-1], x=axis)
    return figure


def _bars(axes: Axes, stance: np.ndarray, span: float, color: str) -> None:
    """A bar for every stretch on the ground."""
    width = span / len(stance)
    for leg, down in enumerate(stance.T):
        bars = [(first * width, (after - first) * width) for first, after in runs_of_true(down)]
        axes.broken_barh(bars, (leg - 0.36, 0.72), color=color, linewidth=0)
