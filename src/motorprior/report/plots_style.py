"""Style of all pictures: a colour and a dash pattern per actuator model, axes, labels, legends.

Styles are set on the artists, not in matplotlib's global settings, so that two threads may draw at
once.
"""

from collections.abc import Iterable
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

# colour; label, if it is not the key with spaces in place of underscores; dashes in units of the
# line width
_STYLES: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "physical": ("#15181d", "", ()),
    "measured": ("#15181d", "", ()),
    "oracle": ("#4b5360", "", (5, 1.5)),
    "ideal_pd": ("#979da6", "ideal PD", (1.2, 1.2)),
    "tuned_pd": ("#a8672c", "tuned PD", (4, 1.2, 1, 1.2)),
    "one_network": ("#1a9a8b", "", (3, 1.5)),
    "paper": ("#cf3b3b", "", ()),
    "paper_wide": ("#e08a1e", "paper, wide", ()),
    "rollout": ("#2563c9", "", ()),
    "friction_pd": ("#8a8f3c", "PD with friction", (2, 1)),
    "random_pd": ("#c2459a", "randomised PD", (6, 1, 1, 1)),
    "adapted_pd": ("#5d6b1f", "adapted PD", (8, 1.5)),
    "central_motor": ("#7fb2f0", "prior's central motor", (1.2, 1.2)),
    "prior": ("#1d56c4", "", ()),
    "sampled_prior": ("#1d56c4", "sampled prior", ()),
    "adapted_prior": ("#6a3fb5", "adapted prior", (5, 1.5)),
    "robust_prior": ("#0c86a8", "prior + randomised body", (4, 1.2, 1, 1.2)),
    "adapted": ("#6a3fb5", "", ()),
    "per_motor": ("#0c86a8", "", ()),
    "pooled_network": ("#1a9a8b", "", (3, 1.5)),
    "pure_delay": ("#e08a1e", "", (1.2, 1.2)),
    "second_order": ("#a8672c", "", (4, 1.2, 1, 1.2)),
    "servo_limits": ("#2563c9", "", ()),
}
OTHER_COLOR = "#7d4fa8"
INK = "#15181d"
MUTED = "#5b6470"
FAINT = "#e4e6e9"
TEXT = 8.5  # size of small text [pt]
TIME = "time [s]"


def model_key(model: str) -> str | None:
    """Key of _STYLES for a model or a variant of it, such as `rollout` for ``rollout_adapted``."""
    fitting = [key for key in _STYLES if model == key or model.startswith((f"{key}_", f"{key} "))]
    return max(fitting, key=len, default=None)


def model_color(model: str) -> str:
    """Colour of a model and its variants; OTHER_COLOR for an unknown one."""
    key = model_key(model)
    return _STYLES[key][0] if key else OTHER_COLOR


def model_label(model: str) -> str:
    """Display name; a variant keeps its suffix, an unknown model its name without underscores."""
    key = model_key(model)
    return ((_STYLES[key][1] or key) + model[len(key) :] if key else model).replace("_", " ")


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
    """(rows, columns) axes with a frame on two sides and a faint grid; ``share`` is sharex / sharey."""
    axes = figure.subplots(rows, columns, squeeze=False, height_ratios=heights, **share)
    for each in axes.flat:
        each.spines[["top", "right"]].set_visible(False)
        each.tick_params(labelsize=TEXT)
        each.grid(True, color=FAINT, linewidth=0.6)
        each.set_axisbelow(True)
    return axes


def describe(
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
    if (key := model_key(model)) and (dashes := _STYLES[key][2]):
        line.set_dashes(dashes)
    return line


def target_line(axes: Axes, time: np.ndarray, position_target: np.ndarray) -> Line2D:
    """The commanded angle, held from one row to the next."""
    return axes.plot(
        time,
        position_target,
        label="position target",
        color="#b9a24a",
        lw=1.0,
        drawstyle="steps-post",
    )[0]


def legend_below(figure: Figure, axes: Axes | Iterable[Axes], columns: int = 4) -> None:
    """One legend of all labels below the figure, whose y labels are aligned."""
    figure.align_ylabels()
    every = [axes] if isinstance(axes, Axes) else axes
    found = {
        text: mark
        for each in every
        for mark, text in zip(*each.get_legend_handles_labels(), strict=True)
    }
    marks = list(found.values())
    texts = list(found)
    figure.legend(
        marks, texts, loc="outside lower left", ncols=columns, fontsize=TEXT, frameon=False
    )


def fit_y(axes: Axes, reference: np.ndarray, margin: float) -> None:
    """Limits ``margin`` times its range around ``reference``: a model that diverges leaves the picture."""
    values = reference[np.isfinite(reference)]
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    extent = max(high - low, 1e-6)
    axes.set_ylim(low - margin * extent, high + margin * extent)


def png_bytes(figure: Figure, dpi: int = 120) -> bytes:
    """The figure as PNG; equal figures give equal bytes."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=dpi, metadata={"Software": None})
    return out.getvalue()
