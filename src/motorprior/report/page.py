"""The report: one HTML file with sections of text, pictures and tables, the settings and the command."""

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
    kind: Literal["png", "gif"] = "png"

    @property
    def uri(self) -> str:
        """The image as a data URI."""
        return f"data:image/{self.kind};base64,{base64.b64encode(self.data).decode('ascii')}"


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

    ``command`` makes the same page; ``complete``: all stages of the run are finished.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = files("motorprior.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    return environment.from_string(template).render(
        title=title,
        sections=[
            (re.sub(r"[^a-z0-9]+", "-", section.title.lower()).strip("-"), section)
            for section in sections
        ],
        settings=[
            (name, ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value))
            for name, value in settings.items()
        ],
        command=command,
        complete=complete,
        label=lambda cell: model_label(cell) if model_key(cell) else cell,
        is_number=lambda cell: re.match(r"[-+]?\d", cell) is not None,
        color=lambda cell: model_color(cell) if model_key(cell) else None,
    )
