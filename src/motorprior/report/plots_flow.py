"""The system as a picture: six boxes in a circle, as SVG that takes the page's colours."""

from __future__ import annotations

from html import escape

STAGES = (
    ("motor logs", "checked, in SI units"),
    ("motor prior", "a distribution of motors"),
    ("simulation", "other motors in every episode"),
    ("policy", "learns to walk on all of them"),
    ("transfer study", "held-out motors, fair baselines"),
    ("robot", "the policy on the real machine"),
)
FEEDBACK = "logs recorded on the robot"

_WIDE = {"width": 232, "height": 68, "gap": 40, "rise": 58}
_NARROW = {"width": 250, "height": 54, "gap": 20}


def flow_svg(*, narrow: bool = False) -> str:
    """Motor logs → motor prior → simulation → policy → transfer study → robot, and back to motor logs.

    Args:
        narrow: one column, for a phone, instead of a circle of two rows.
    """
    body, width, height = _column() if narrow else _circle()
    described = "; ".join(f"{name}: {line}" for name, line in STAGES)
    kind = "narrow" if narrow else "wide"
    return f"""<svg class="flow flow-{kind}" viewBox="0 0 {width} {height}" role="img"
  aria-label="The flow: {escape(described)}. Then {FEEDBACK} go back to motor logs.">
<defs>{_marker(kind, "line")}{_marker(kind, "back")}</defs>
{body}
</svg>"""


def _marker(kind: str, name: str) -> str:
    """An arrow head."""
    return (
        f'<marker id="flow-{kind}-{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path class="flow-head-{name}" d="M0 0.6 7.4 4 0 7.4z"/></marker>'
    )


def _circle() -> tuple[str, int, int]:
    """First row to the right, second row back to the left; body, width, height."""
    size = _WIDE
    across, down = size["width"] + size["gap"], size["height"] + size["rise"]
    places = [(1 + across * column, 1) for column in range(3)]
    places += [(1 + across * column, 1 + down) for column in (2, 1, 0)]
    parts = [_box(*at, size, *stage) for at, stage in zip(places, STAGES, strict=True)]
    middle, centre = size["height"] // 2 + 1, size["width"] // 2 + 1
    for column in range(2):
        start = 1 + across * column + size["width"]
        parts.append(_arrow("wide", start + 4, middle, start + size["gap"] - 4, middle))
        parts.append(_arrow("wide", start + size["gap"] - 4, middle + down, start + 4, middle + down))
    low, high = size["height"] + 5, down - 3
    parts.append(_arrow("wide", centre + 2 * across, low, centre + 2 * across, high))
    parts.append(_arrow("wide", centre, high, centre, low, "back"))
    parts.append(_text(centre + 14, (low + high) // 2 + 4, FEEDBACK, "flow-note", "start"))
    return "\n".join(parts), 2 + 2 * across + size["width"], 2 + down + size["height"]


def _column() -> tuple[str, int, int]:
    """One box under the other, the way back at the right; body, width, height."""
    size = _NARROW
    down = size["height"] + size["gap"]
    parts = [_box(1, 1 + down * row, size, *stage) for row, stage in enumerate(STAGES)]
    centre, right = size["width"] // 2, size["width"] + 5
    for row in range(len(STAGES) - 1):
        top = down * row + size["height"] + 4
        parts.append(_arrow("narrow", centre, top, centre, top + size["gap"] - 6))
    first, last = size["height"] // 2 + 1, down * 5 + size["height"] // 2 + 1
    path = f"M{right} {last}h18q10 0 10-10V{first + 10}q0-10-10-10h-16"
    parts.append(f'<path class="flow-back" d="{path}" marker-end="url(#flow-narrow-back)"/>')
    x, y = right + 46, (first + last) // 2
    parts.append(f'<g transform="rotate(-90 {x} {y})">{_text(x, y, FEEDBACK, "flow-note")}</g>')
    return "\n".join(parts), size["width"] + 62, 2 + down * 5 + size["height"]


def _box(x: int, y: int, size: dict[str, int], name: str, line: str) -> str:
    """One stage: its name and one line about it."""
    middle, centre = y + size["height"] // 2, x + size["width"] // 2
    return (
        f'<rect class="flow-box" x="{x}" y="{y}" width="{size["width"]}" height="{size["height"]}" rx="9"/>'
        + _text(centre, middle - 5, name, "flow-name")
        + _text(centre, middle + 15, line, "flow-line")
    )


def _text(x: int, y: int, text: str, kind: str, anchor: str = "middle") -> str:
    return f'<text class="{kind}" x="{x}" y="{y}" text-anchor="{anchor}">{escape(text)}</text>'


def _arrow(kind: str, x1: int, y1: int, x2: int, y2: int, name: str = "line") -> str:
    head = f'marker-end="url(#flow-{kind}-{name})"'
    return f'<path class="flow-{name}" d="M{x1} {y1}L{x2} {y2}" {head}/>'
