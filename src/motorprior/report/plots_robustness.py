"""Heat maps of the time upright over two disturbances."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from motorprior.report.plots_style import INK, TEXT, describe, new_figure, panels
from motorprior.transfer.robustness import UprightMap

_COLORS = LinearSegmentedColormap.from_list("upright", ["#cf3b3b", "#f2d9a8", "#dcebe4", "#58b09c"])


def robustness_maps(maps: Sequence[UprightMap]) -> Figure:
    """The maps next to each other, with the value of each cell [%]."""
    figure = new_figure(3.0)
    for axes, shown in zip(panels(figure, 1, len(maps))[0], maps, strict=True):
        _heat_map(axes, shown)
    return figure


def _heat_map(axes: Axes, shown: UprightMap) -> None:
    axes.imshow(shown.share, origin="lower", cmap=_COLORS, vmin=0.0, vmax=1.0, aspect="auto")
    for row, values in enumerate(shown.share):
        for column, value in enumerate(values):
            axes.text(column, row, f"{100.0 * value:.0f}", ha="center", va="center", fontsize=TEXT, color=INK)
    axes.set_xticks(range(len(shown.columns.values)), [f"{value:g}" for value in shown.columns.values])
    axes.set_yticks(range(len(shown.rows.values)), [f"{value:g}" for value in shown.rows.values])
    axes.grid(False)
    axes.tick_params(length=0)
    describe(axes, x=shown.columns.title, y=shown.rows.title, title="time upright [%]")
