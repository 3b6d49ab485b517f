"""The report: one self-contained HTML page of pictures, tables and paragraphs."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from motorprior.artifacts import dotted, write_text
from motorprior.exceptions import ConfigError
from motorprior.report.plots_flow import flow_svg
from motorprior.report.plots_style import DPI, model_color, model_key, model_label, png_bytes

Cell = str | float | int | bool | None

THIN_SPACE, MINUS = "\u202f", "\u2212"
_NUMERIC = re.compile(r"[+\-−±<>≤≥~≈]?\s*\d[\d.,\s]*(\s*[±–-]\s*[\d.]+)?\s*[%×]?")

_MIME = {"png": "image/png", "gif": "image/gif", "svg": "image/svg+xml"}
_SMALL_SVG = 24_000
"""A drawing below this many bytes stays a drawing: sharp at any zoom. Above, PNG is smaller."""


@dataclass(frozen=True)
class Picture:
    """An image file with its caption and its alternative text."""

    caption: str
    alt: str
    data: bytes
    kind: Literal["png", "gif", "svg"]

    @property
    def uri(self) -> str:
        """The image itself as an address."""
        return f"data:{_MIME[self.kind]};base64,{base64.b64encode(self.data).decode('ascii')}"


@dataclass(frozen=True)
class Table:
    """Rows of cells. Floats get 3 significant digits; the name of an actuator model gets its colour."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str


@dataclass(frozen=True)
class Section:
    """A section: a one-sentence summary, paragraphs, pictures and tables, all as plain text."""

    title: str
    lead: str
    body: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class Report:
    """The page.

    Attributes:
        title: of the page.
        subtitle: one sentence under it.
        sections: in reading order.
        settings: what the run was made with; nested dictionaries are allowed.
        command: what to type to make the same page.
        pending: stages whose results are still to come; empty when the report is complete.
        highlights: (value with unit, what it is) of the few numbers to see first.
    """

    title: str
    subtitle: str
    sections: tuple[Section, ...]
    settings: Mapping[str, Any]
    command: str
    pending: tuple[str, ...] = ()
    highlights: tuple[tuple[str, str], ...] = ()


def picture(figure: Figure, caption: str, alt: str) -> Picture:
    """The figure as SVG if that is small, else as PNG. Equal figures give equal bytes."""
    svg = _svg_bytes(figure) if _is_simple(figure) else b""
    if 0 < len(svg) <= _SMALL_SVG:
        return Picture(caption, alt, svg, "svg")
    return Picture(caption, alt, png_bytes(figure, DPI), "png")


def render(report: Report) -> str:
    """The page as HTML text.

    Raises:
        ConfigError: a table has a row that is longer or shorter than its columns.
    """
    for section in report.sections:
        for table in section.tables:
            _check_rows(table)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = files("motorprior.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    return environment.from_string(template).render(
        report=report,
        anchors=_anchors([section.title for section in report.sections]),
        settings=[(name, _listed(value)) for name, value in dotted(report.settings).items() if value != {}],
        flow_wide=Markup(flow_svg()),
        flow_narrow=Markup(flow_svg(narrow=True)),
        cells=_cells,
    )


def write_report(path: Path, report: Report) -> None:
    """Write the page atomically."""
    write_text(path, render(report))


@dataclass(frozen=True)
class _Shown:
    """A table cell as the page shows it."""

    text: str
    color: str | None
    is_number: bool


def _cells(table: Table) -> list[list[_Shown]]:
    """Every cell of a table, numbers of a column brought to one decimal point."""
    columns = []
    for index in range(len(table.columns)):
        values = [row[index] for row in table.rows]
        if is_number_column(values):
            columns.append([_Shown(text, None, True) for text in aligned(values)])
        else:
            columns.append([_word(value) for value in values])
    return [list(row) for row in zip(*columns, strict=True)]


def _word(value: Cell) -> _Shown:
    if isinstance(value, str) and model_key(value):
        return _Shown(model_label(value), model_color(value), False)
    return _Shown(aligned([value])[0], None, False)


def _check_rows(table: Table) -> None:
    for index, row in enumerate(table.rows):
        if len(row) != len(table.columns):
            raise ConfigError(
                f'table "{table.caption}", row {index} has {len(row)} cells for {len(table.columns)} columns',
                remedy="give one cell per column, None where there is no value",
            )


def _anchors(titles: list[str]) -> list[str]:
    """An address within the page per title, each its own."""
    anchors: list[str] = []
    for title in titles:
        plain = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
        repeats = sum(anchor == plain or anchor.startswith(f"{plain}--") for anchor in anchors)
        anchors.append(f"{plain}--{repeats + 1}" if repeats else plain)
    return anchors


def _listed(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _is_simple(figure: Figure) -> bool:
    """Few enough points and marks that SVG could be small."""
    points = sum(np.size(line.get_xdata()) for axes in figure.axes for line in axes.lines)
    marks = sum(len(axes.patches) + 20 * len(axes.collections) for axes in figure.axes)
    return points + 5 * marks < 1000


def _svg_bytes(figure: Figure) -> bytes:
    """The figure as SVG without date and program name; text as outlines, ids that depend on nothing."""
    out = BytesIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": "motorprior", "svg.fonttype": "path"}):
        figure.savefig(out, format="svg", metadata=nothing, facecolor="white")
    return out.getvalue()


def number(value: float | int, decimals: int | None = None) -> str:
    """A number with ``decimals``, or 3 significant digits; what is not finite in words."""
    if isinstance(value, int):
        text = f"{value:,}"
    elif not math.isfinite(value):
        text = "n/a" if math.isnan(value) else "diverged"
    elif decimals is None and value and not 1e-4 <= abs(value) < 1e6:
        text = f"{value:.2e}"
    else:
        text = f"{value:,.{_decimals(value, 3) if decimals is None else decimals}f}"
    return text.replace(",", THIN_SPACE).replace("-", MINUS)


def _decimals(value: float, digits: int) -> int:
    """Decimals that show ``digits`` significant digits."""
    return max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0


def is_number_column(values: Sequence[Cell]) -> bool:
    """Every value that is there is a number or a text that starts and reads like one."""
    there = [value for value in values if value is not None and value not in ("", "–", "-")]
    return bool(there) and all(_numeric(value) for value in there)


def _numeric(value: Cell) -> bool:
    if isinstance(value, str):
        return _NUMERIC.fullmatch(value.strip()) is not None
    return not isinstance(value, bool)


def aligned(values: Sequence[Cell]) -> list[str]:
    """The values as text. Floats have the same decimals, so their points meet where digits are of one width."""
    decimals = _common_decimals([value for value in values if isinstance(value, float) and math.isfinite(value)])
    return [_text(value, decimals) for value in values]


def _common_decimals(values: Sequence[float]) -> int | None:
    """Decimals for a column: 3 digits of the largest value, 2 of the smallest; None if these differ too much."""
    sizes = [abs(value) for value in values if value]
    if not sizes or max(sizes) >= 1e6 or max(sizes) / min(sizes) > 1e4:
        return None
    most = max(_decimals(max(sizes), 3), _decimals(min(sizes), 2))
    needed = [len(f"{value:.{most}f}".rstrip("0").partition(".")[2]) for value in values]
    return max(needed)


def _text(value: Cell, decimals: int | None = None) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else number(value, decimals)
