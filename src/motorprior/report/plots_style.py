"""Style of all pictures of the report: one colour and one dash per actuator model, sizes, axes, files.

Everything is set on the artists themselves: nothing global changes, so two threads may draw at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

MODEL_COLORS = {
    "truth": "#15181d",
    "physical": "#15181d",
    "measured": "#15181d",
    "oracle": "#4b5360",
    "untrained": "#c9b458",
    "ideal_pd": "#979da6",
    "tuned_pd": "#a8672c",
    "one_network": "#1a9a8b",
    "paper": "#cf3b3b",
    "paper_wide": "#e08a1e",
    "rollout": "#2563c9",
    "pd_friction": "#8a8f3c",
    "pd_randomised": "#c2459a",
    "pd_adapted": "#5d6b1f",
    "prior_mean": "#7fb2f0",
    "prior": "#1d56c4",
    "prior_adapted": "#6a3fb5",
    "prior_robust": "#0c86a8",
}
"""One colour per actuator model, in every plot and every table."""

MODEL_LABELS = {
    "truth": "truth",
    "physical": "physical",
    "measured": "measured",
    "oracle": "oracle",
    "untrained": "nothing: the gait",
    "ideal_pd": "ideal PD",
    "tuned_pd": "tuned PD",
    "one_network": "one network",
    "paper": "paper",
    "paper_wide": "paper, wide",
    "rollout": "rollout",
    "pd_friction": "PD with friction",
    "pd_randomised": "randomised PD",
    "pd_adapted": "adapted PD",
    "prior_mean": "prior's central motor",
    "prior": "sampled prior",
    "prior_adapted": "adapted prior",
    "prior_robust": "prior + random body",
}
"""Label of each actuator model."""

MODEL_DASHES: dict[str, tuple[float, ...]] = {
    "oracle": (5, 1.5),
    "untrained": (1, 2),
    "ideal_pd": (1.2, 1.2),
    "tuned_pd": (4, 1.2, 1, 1.2),
    "one_network": (3, 1.5),
    "pd_friction": (2, 1),
    "pd_randomised": (6, 1, 1, 1),
    "pd_adapted": (8, 1.5),
    "prior_mean": (1.2, 1.2),
    "prior_adapted": (5, 1.5),
    "prior_robust": (4, 1.2, 1, 1.2),
}
"""Line patterns in units of the line width, so that lines differ without colour; the others are solid."""

OTHER_COLOR = "#7d4fa8"
UNNAMED_COLOR = "#b3a99c"
"""Of a condition of a study that a user gave a name of their own."""
INK, MUTED, FAINT = "#15181d", "#5b6470", "#e4e6e9"
TARGET_COLOR = "#b9a24a"
WIDTH = 6.6
"""Width of a figure [in]: text of 9 pt stays legible on a phone."""
TEXT = 8.5
"""Size of all text [pt], titles one larger."""
DPI = 180


def model_key(model: str) -> str | None:
    """The key of MODEL_COLORS ``model`` is a variant of: itself, or `rollout` for ``rollout_adapted``."""
    fitting = [key for key in MODEL_COLORS if model == key or model.startswith((f"{key}_", f"{key} "))]
    return max(fitting, key=len, default=None)


def model_color(model: str) -> str:
    """Its colour; a variant has that of its model, an unknown one OTHER_COLOR."""
    key = model_key(model)
    return MODEL_COLORS[key] if key else OTHER_COLOR


def distinct_colors(models: Iterable[str]) -> dict[str, str]:
    """A colour for each of some lines of one plot: its model's, or where another line has that, a free one."""
    colors: dict[str, str] = {}
    for model in models:
        free = (color for color in MODEL_COLORS.values() if color not in colors.values())
        own = model_color(model)
        colors[model] = next(free, own) if own in colors.values() else own
    return colors


def condition_color(condition: str) -> str:
    """Of what a policy was trained on: a model's colour, or UNNAMED_COLOR."""
    return model_color(condition) if model_key(condition) else UNNAMED_COLOR


def model_label(model: str) -> str:
    """Its name for readers; a variant keeps its ending, an unknown one its name without underscores."""
    key = model_key(model)
    ending = model[len(key) :] if key else model
    return (MODEL_LABELS.get(key or "", "") + ending).replace("_", " ")


def new_figure(
    height: float, width: float = WIDTH, layout: Literal["constrained", "compressed"] = "constrained"
) -> Figure:
    """An empty white figure [in] that arranges itself."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    figure.get_layout_engine().set(w_pad=0.05, h_pad=0.05, hspace=0.03, wspace=0.04)  # pyright: ignore
    return figure


def panels(
    figure: Figure, rows: int, columns: int = 1, *, heights: tuple[float, ...] | None = None, **share: Any
) -> np.ndarray:
    """(rows, columns) styled axes; ``share`` is sharex / sharey."""
    axes = figure.subplots(rows, columns, squeeze=False, height_ratios=heights, **share)
    for each in axes.flat:
        style(each)
    return axes


def style(axes: Axes) -> None:
    """Thin grey frame on two sides, faint grid, small numbers."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set(color="#aab0b8", linewidth=0.7)
    axes.tick_params(labelsize=TEXT - 0.5, color="#aab0b8", labelcolor=MUTED, width=0.7, length=3)
    axes.grid(True, color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)


def describe(axes: Axes, x: str | None = None, y: str | None = None, title: str | None = None) -> None:
    """Axis labels (with their unit) and a title flush left."""
    if x is not None:
        axes.set_xlabel(x, fontsize=TEXT, color=MUTED)
    if y is not None:
        axes.set_ylabel(y, fontsize=TEXT, color=MUTED)
    if title is not None:
        axes.set_title(title, loc="left", fontsize=TEXT + 1, fontweight="bold", color=INK, pad=7)


def model_line(
    axes: Axes, x: np.ndarray, y: np.ndarray, model: str, label: str | None = None, color: str | None = None
) -> Line2D:
    """The line of one actuator model, in its own colour if none is given."""
    name = model_label(model) if label is None else label
    (line,) = axes.plot(x, y, color=color or model_color(model), linewidth=1.3, label=name)
    dashes = MODEL_DASHES.get(model_key(model) or "")
    if dashes:
        line.set_dashes(dashes)
    return line


def target_line(axes: Axes, time: np.ndarray, position_target: np.ndarray) -> Line2D:
    """The commanded angle, held from one row to the next."""
    style = {"color": TARGET_COLOR, "linewidth": 1.0, "drawstyle": "steps-post"}
    return axes.plot(time, position_target, label="position target", **style)[0]


def legend_below(figure: Figure, axes: Axes | Iterable[Axes], columns: int = 4) -> None:
    """One legend for the whole figure, under it: it never covers data. Of several axes, every label once."""
    every = [axes] if isinstance(axes, Axes) else axes
    found = {text: mark for each in every for mark, text in zip(*each.get_legend_handles_labels(), strict=True)}
    figure.legend(
        list(found.values()), list(found), loc="outside lower left", ncols=columns, fontsize=TEXT, frameon=False,
        labelcolor=INK, handlelength=2.2, columnspacing=1.6,
    )  # fmt: skip


def fit_y(axes: Axes, trusted: list[np.ndarray], others: list[np.ndarray], room: float = 0.6) -> None:
    """Limits that show ``trusted`` whole and ``others`` as far as ``room`` times that span beyond it.

    So a model that diverges leaves the picture instead of flattening the others.
    """
    low, high = span(trusted)
    reach = max(high - low, 1e-6)
    far_low, far_high = span([*trusted, *others])
    low, high = max(far_low, low - room * reach), min(far_high, high + room * reach)
    axes.set_ylim(low - 0.05 * reach, high + 0.05 * reach)


def span(arrays: list[np.ndarray]) -> tuple[float, float]:
    """Lowest and highest finite value, (0, 1) without any."""
    values = np.concatenate([np.ravel(array) for array in arrays]) if arrays else np.empty(0)
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)


def two_digits(value: float) -> str:
    """2 significant digits, whole numbers from 10 on."""
    if value == 0.0:
        return "0"
    text = f"{value:.0f}" if abs(value) >= 10 else f"{value:#.2g}"
    return text.replace("-", "−")


def png_bytes(figure: Figure, dpi: int = DPI) -> bytes:
    """The figure as PNG of 256 colours without date and program name: equal figures give equal bytes."""
    drawn, out = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi, facecolor="white", pil_kwargs={"compress_level": 1})
    image = Image.open(drawn).convert("RGB")
    with_palette(image, most_used([image], 256)).save(out, "PNG", optimize=True)
    return out.getvalue()


def most_used(images: list[Image.Image], count: int) -> np.ndarray:
    """The ``count`` colours that RGB images have most of, as 0xRRGGBB; a model keeps its exact colour."""
    colors, uses = np.unique(np.concatenate([_pixels(image) for image in images]), return_counts=True)
    return colors[np.argsort(-uses, kind="stable")[:count]]


def with_palette(image: Image.Image, palette: np.ndarray) -> Image.Image:
    """The RGB image in these colours (K,), K <= 256: each pixel takes the nearest one.

    Pillow's own `quantize` matches colours coarsely, which turns white into almost white.
    """
    colors, place = np.unique(_pixels(image), return_inverse=True)
    gap = _channels(colors)[:, None, :] - _channels(palette)[None, :, :]
    index = np.argmin(np.sum(gap * gap, axis=2), axis=1).astype(np.uint8)[place]
    flat = Image.fromarray(index.reshape(image.height, image.width))
    flat.putpalette(_channels(palette).astype(np.uint8).ravel().tolist())
    return flat


def _pixels(image: Image.Image) -> np.ndarray:
    """(N,) colours as 0xRRGGBB."""
    red, green, blue = np.asarray(image).reshape(-1, 3).astype(np.int32).T
    return red << 16 | green << 8 | blue


def _channels(colors: np.ndarray) -> np.ndarray:
    """(N, 3) red, green, blue of (N,) colours."""
    return np.stack([colors >> 16, colors >> 8 & 255, colors & 255], axis=1).astype(np.int32)
