"""Style of all pictures: a colour and a dash pattern per actuator model, axes, labels, legends.

Styles are set on the artists, not in matplotlib's global settings, so that two threads may draw at
once.
"""

from collections.abc import Iterable
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D


class _Style(NamedTuple):
    """Style of an actuator model."""

    color: str
    label: str = ""  # if it is not the key with spaces in place of underscores
    dashes: tuple[float, ...] = ()  # in units of the line width; none: a solid line


_STYLES = {
    "physical": _Style("#15181d"),
    "measured": _Style("#15181d"),
    "oracle": _Style("#4b5360", dashes=(5, 1.5)),
    "ideal_pd": _Style("#979da6", "ideal PD", dashes=(1.2, 1.2)),
    "tuned_pd": _Style("#a8672c", "tuned PD", dashes=(4, 1.2, 1, 1.2)),
    "one_network": _Style("#1a9a8b", dashes=(3, 1.5)),
    "paper": _Style("#cf3b3b"),
    "paper_wide": _Style("#e08a1e", "paper, wide"),
    "rollout": _Style("#2563c9"),
    "friction_pd": _Style("#8a8f3c", "PD with friction", dashes=(2, 1)),
    "random_pd": _Style("#c2459a", "randomised PD", dashes=(6, 1, 1, 1)),
    "adapted_pd": _Style("#5d6b1f", "adapted PD", dashes=(8, 1.5)),
    "central_motor": _Style("#7fb2f0", "prior's central motor", dashes=(1.2, 1.2)),
    "prior": _Style("#1d56c4"),
    "sampled_prior": _Style("#1d56c4", "sampled prior"),
    "adapted_motors": _Style("#b39ddb", "adapted motors' mean", dashes=(1.2, 1.2)),
    "adapted_prior": _Style("#6a3fb5", "adapted prior", dashes=(5, 1.5)),
    "robust_prior": _Style("#0c86a8", "prior + randomised body", dashes=(4, 1.2, 1, 1.2)),
    "adapted": _Style("#6a3fb5"),
    "per_motor": _Style("#0c86a8"),
    "pooled_network": _Style("#1a9a8b", dashes=(3, 1.5)),
    "pure_delay": _Style("#e08a1e", dashes=(1.2, 1.2)),
    "second_order": _Style("#8a8f3c", "second order + delay", dashes=(4, 1.2, 1, 1.2)),
    "servo_limits": _Style("#cf3b3b", "response with limits"),
    "coulomb_viscous": _Style("#c2459a", "Coulomb + viscous friction", dashes=(6, 1, 1, 1)),
    "stribeck": _Style("#4f6f52", "Stribeck friction", dashes=(2, 1)),
}
OTHER_COLOR = "#7d4fa8"
INK = "#15181d"
MUTED = "#5b6470"
FAINT = "#e4e6e9"
_TARGET_COLOR = "#b9a24a"
TEXT = 8.5  # size of small text [pt]
TIME = "time [s]"


def model_key(model: str) -> str | None:
    """Key of _STYLES for a model or a variant of it, such as `rollout` for ``rollout_adapted``."""
    keys = [key for key in _STYLES if model == key or model.startswith((f"{key}_", f"{key} "))]
    return max(keys, key=len, default=None)


def model_color(model: str) -> str:
    """Colour of a model and its variants; OTHER_COLOR for an unknown one."""
    key = model_key(model)
    return _STYLES[key].color if key else OTHER_COLOR


def model_label(model: str) -> str:
    """Display name; a variant keeps its suffix, an unknown model its name without underscores."""
    key = model_key(model)
    label = model
    if key:
        suffix = model[len(key) :]
        label = (_STYLES[key].label or key) + suffix
    return label.replace("_", " ")


def new_figure(height: float) -> Figure:
    """An empty figure of this height [in] with a constrained layout."""
    return Figure(figsize=(6.6, height), layout="constrained")


def panels(
    figure: Figure,
    rows: int,
    columns: int = 1,
    *,
    heights: tuple[float, ...] | None = None,
    **share: Any,
) -> np.ndarray:
    """(rows, columns) axes with a frame on two sides and a faint grid.

    ``share`` is sharex and sharey.
    """
    grid = figure.subplots(rows, columns, squeeze=False, height_ratios=heights, **share)
    for axes in grid.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=TEXT)
        axes.grid(True, color=FAINT, linewidth=0.6)
        axes.set_axisbelow(True)
    return grid


def set_labels(
    axes: Axes, x: str | None = None, y: str | None = None, title: str | None = None
) -> None:
    """Axis labels (with their unit) and a title at the left."""
    if x is not None:
        axes.set_xlabel(x, fontsize=TEXT)
    if y is not None:
        axes.set_ylabel(y, fontsize=TEXT)
    if title is not None:
        axes.set_title(title, loc="left", fontsize=TEXT + 1, fontweight="bold")


def model_line(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    model: str,
    label: str | None = None,
    color: str | None = None,
) -> Line2D:
    """The line of an actuator model, by default in its colour."""
    name = model_label(model) if label is None else label
    (line,) = axes.plot(x, y, color=color or model_color(model), linewidth=1.3, label=name)
    key = model_key(model)
    if key and _STYLES[key].dashes:
        line.set_dashes(_STYLES[key].dashes)
    return line


def target_line(axes: Axes, time: np.ndarray, position_target: np.ndarray) -> Line2D:
    """The commanded angle, held from one row to the next."""
    (line,) = axes.plot(
        time,
        position_target,
        label="position target",
        color=_TARGET_COLOR,
        lw=1.0,
        drawstyle="steps-post",
    )
    return line


def legend_below(figure: Figure, axes: Axes | Iterable[Axes], columns: int = 4) -> None:
    """One legend of all labels below the figure, whose y labels are aligned."""
    figure.align_ylabels()
    all_axes = [axes] if isinstance(axes, Axes) else axes
    handles = {}  # one per label
    for with_labels in all_axes:
        for handle, label in zip(*with_labels.get_legend_handles_labels(), strict=True):
            handles[label] = handle
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside lower left",
        ncols=columns,
        fontsize=TEXT,
        frameon=False,
    )


def fit_y(axes: Axes, shown: np.ndarray, margin: float) -> None:
    """Limits of the y axis around the values ``shown``, so that a model that diverges leaves them.

    The margin is a share of the range of these values.
    """
    finite = shown[np.isfinite(shown)]
    if not len(finite):
        finite = np.array([0.0, 1.0])
    low = finite.min()
    high = finite.max()
    extent = max(high - low, 1e-6)
    axes.set_ylim(low - margin * extent, high + margin * extent)


def png_bytes(figure: Figure, dpi: int = 120) -> bytes:
    """The figure as PNG; equal figures give equal bytes."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None})
    return out.getvalue()
