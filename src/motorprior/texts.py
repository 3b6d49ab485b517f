"""Summaries of objects for people: a headline, facts and a table."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

MAX_LINES = 10  # maximum lines of a repr
_MAX_LETTERS = 160  # maximum length of a fact


def text_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns, the first to the left."""
    cells = [list(columns), *map(list, rows)]
    widths = []
    for column in range(len(columns)):
        widths.append(max(len(row[column]) for row in cells))

    def line(row: Sequence[str]) -> str:
        aligned = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        aligned[0] = row[0].ljust(widths[0])
        return "  ".join(aligned).rstrip()

    rule = "  ".join("-" * width for width in widths)
    return "\n".join([line(cells[0]), rule, *map(line, cells[1:])])


def html_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The table for notebooks and pages."""

    def line(tag: str, row: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"

    lines = [line("td", row) for row in rows]
    return "\n".join(["<table>", line("th", columns), *lines, "</table>"])


@dataclass(frozen=True)
class Overview:
    """Summary of an object."""

    headline: str
    facts: Mapping[str, str] = field(default_factory=dict)  # empty ones are left out
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    further_tables: Sequence[tuple[Sequence[str], Sequence[Sequence[str]]]] = ()  # columns, rows

    @property
    def _lines(self) -> list[str]:
        facts = [f"  {name}: {text[:_MAX_LETTERS]}" for name, text in self.facts.items() if text]
        return [self.headline, *facts]

    @property
    def short(self) -> str:
        """Headline and facts, in at most MAX_LINES lines."""
        return "\n".join(self._lines[:MAX_LINES])

    def __str__(self) -> str:
        lines = self._lines
        if self.rows:
            lines.append(text_table(self.columns, self.rows))
        for columns, rows in self.further_tables:
            lines.append(text_table(columns, rows))
        return "\n".join(lines)


class ShownInNotebooks:
    """Notebooks show its ``str``, in letters of one width."""

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


class Printable(ShownInNotebooks):
    """Prints as its `overview`; its ``repr`` is the short form."""

    def overview(self) -> Overview:
        """What a person wants to know."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return self.overview().short

    def __str__(self) -> str:
        return str(self.overview())
