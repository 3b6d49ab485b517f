"""Pictures of trainings and of walks: learning curves, transfer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from motorprior.artifacts import read_json
from motorprior.report.plots_style import (
    describe,
    legend_below,
    model_color,
    model_key,
    model_label,
    model_line,
    new_figure,
    panels,
)

Curve = tuple[np.ndarray, np.ndarray]  # iteration (N,) [-], mean return (N,) [m]


def read_curves(folders: Iterable[Path]) -> list[Curve]:
    """Learning curves of trainings, from curve.json in their folders."""
    points = [read_json(folder / "curve.json") for folder in folders]
    return [
        (np.array([each["iteration"] for each in curve]), np.array([each["mean_return"] for each in curve]))
        for curve in points
    ]


def learning_curves(curves: Mapping[str, Sequence[Curve]]) -> Figure:
    """Median over the seeds of each training, and every seed as a thin line."""
    figure = new_figure(3.5)
    (axes,) = panels(figure, 1)[0]
    for number, (name, seeds) in enumerate(curves.items()):
        color = model_color(name) if model_key(name) else f"C{number}"
        for iteration, mean_return in seeds:
            axes.plot(iteration, mean_return, color=color, lw=0.6, alpha=0.4)
        label = f"{model_label(name)}, {len(seeds)} seed" + "s" * (len(seeds) != 1)
        model_line(axes, *_median(seeds), name, label, color).set_linewidth(2.0)
    describe(axes, x="ARS iteration [-]", y="mean return [m]")
    legend_below(figure, axes, columns=3)
    return figure


def _median(seeds: Sequence[Curve]) -> Curve:
    """Median over the seeds where all of them have values."""
    start = max(iteration[0] for iteration, _ in seeds)
    stop = min(iteration[-1] for iteration, _ in seeds)
    grid = np.unique(np.concatenate([iteration for iteration, _ in seeds]))
    grid = grid[(grid >= start) & (grid <= stop)]
    return grid, np.median([np.interp(grid, *seed) for seed in seeds], axis=0)
