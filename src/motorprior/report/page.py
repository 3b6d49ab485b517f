"""The report: one HTML file with sections of text, pictures and tables, settings and command."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

from jinja2 import Environment, StrictUndefined
from matplotlib.figure import Figure

from motorprior.report.plots_style import model_color, model_key, model_label, png_bytes


@dataclass(frozen=True)
class Picture:
    """An image file with its caption."""

    caption: str
    data: bytes
    image_format: Literal["png", "gif"] = "png"

    @property
    def uri(self) -> str:
        """The image as a data URI."""
        text = base64.b64encode(self.data).decode("ascii")
        return f"data:image/{self.image_format};base64,{text}"


@dataclass(frozen=True)
class Table:
    """Rows of cells under column titles; names of models get their label and colour."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading, paragraphs of plain text, pictures and tables."""

    title: str
    text: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


def picture(figure: Figure, caption: str) -> Picture:
    """The figure as a picture of the page."""
    return Picture(caption, png_bytes(figure))


def page(
    title: str,
    sections: Sequence[Section],
    settings: Mapping[str, Any],
    command: str,
    complete: bool = True,
) -> str:
    """The page as HTML, with all pictures inside.

    ``command`` makes the same page; it is empty for a page that was made from Python. ``complete``
    states whether all stages of the run are finished.
    """
    templates = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = files("motorprior.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    return templates.from_string(template).render(
        title=title,
        sections=[(_anchor(section.title), section) for section in sections],
        settings=[(name, _setting_text(value)) for name, value in settings.items()],
        command=command,
        complete=complete,
        label=_label,
        is_number=_is_number,
        color=_color,
    )


def _anchor(title: str) -> str:
    """Identifier of a section in links."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _setting_text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return str(value)


def _label(cell: str) -> str:
    """Display name of a model; other cells stay."""
    return model_label(cell) if model_key(cell) else cell


def _color(cell: str) -> str | None:
    """Colour of a model; None for other cells."""
    return model_color(cell) if model_key(cell) else None


def _is_number(cell: str) -> bool:
    return re.match(r"[-+]?\d", cell) is not None
