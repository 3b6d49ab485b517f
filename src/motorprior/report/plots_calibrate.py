"""Picture of a calibration: what real joints did, and what the fleet fitted to them, or a prior of it, does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_motor import TIME
from motorprior.report.plots_style import (
    MUTED,
    describe,
    legend_below,
    model_color,
    model_line,
    new_figure,
    panels,
    target_line,
)

LONGEST = 5.0
"""Shown of every log, from its start [s]."""


@dataclass(frozen=True)
class Band:
    """What holds a share of the draws of motors.

    Attributes:
        label: whose draws, and the share.
        low: (T,) [rad].
        high: (T,) [rad].
        is_filled: or drawn by its edges.
    """

    label: str
    low: np.ndarray
    high: np.ndarray
    is_filled: bool = True


@dataclass(frozen=True)
class LogPanel:
    """One joint of one log.

    Attributes:
        title: above the panel.
        time: (T,) [s].
        target: (T,) [rad].
        measured: (T,) [rad] on the real robot.
        center: (T,) [rad] of the central motor.
        bands: the widest first.
    """

    title: str
    time: np.ndarray
    target: np.ndarray
    measured: np.ndarray
    center: np.ndarray
    bands: tuple[Band, ...]


def calibration(shown: Sequence[LogPanel]) -> Figure:
    """A row per log: measured angle, central motor, the bands that hold shares of the draws; then their error."""
    figure = new_figure(0.7 + 1.75 * len(shown))
    grid = panels(figure, len(shown), 2)
    for (angle, error), panel in zip(grid, shown, strict=True):
        _draw(angle, error, panel)
    for axes in grid[-1]:
        describe(axes, x=TIME)
    legend_below(figure, grid[0, 0], columns=3 + len(shown[0].bands) // 2)
    figure.align_ylabels()
    return figure


def _draw(angle: Axes, error: Axes, panel: LogPanel) -> None:
    time, color = panel.time - panel.time[0], model_color("rollout")
    part = time <= LONGEST
    time, measured = time[part], panel.measured[part]
    target_line(angle, time, panel.target[part])
    for axes, zero, unit in ((angle, 0.0, 1.0), (error, measured, 1e3)):
        for place, band in enumerate(panel.bands):
            low, high = (unit * (edge[part] - zero) for edge in (band.low, band.high))
            if band.is_filled:
                axes.fill_between(time, low, high, color=color, alpha=0.2 + 0.1 * place, linewidth=0, label=band.label)
            else:
                for edge, label in ((low, band.label), (high, None)):
                    axes.plot(time, edge, color=MUTED, linewidth=0.7, linestyle=":", label=label)
        model_line(axes, time, unit * (measured - zero), "measured").set_linewidth(1.9)
        model_line(axes, time, unit * (panel.center[part] - zero), "rollout", "central motor")
    describe(angle, y="angle [rad]", title=panel.title)
    describe(error, y="minus measured [mrad]")
