"""Text in pictures, in the font that comes with matplotlib: the same everywhere."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from PIL import ImageDraw, ImageFont


def write(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, size: int, color: str, scale: int, anchor: str = "la"
) -> None:
    """Write one line, smaller where it is too long for the picture.

    Args:
        draw: the picture.
        at: (x, y) of the anchor [pixel before scaling].
        text: what to write.
        size: of the letters [pixel before scaling].
        color: of the letters.
        scale: how many times larger the picture is drawn than it is shown.
        anchor: Pillow's code of the point of the text that is at ``at``.
    """
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    font = ImageFont.truetype(str(path), size * scale)
    room = (draw.im.size[0] - 32 * scale) / max(font.getlength(text), 1.0)
    if room < 1.0:
        font = ImageFont.truetype(str(path), max(int(size * scale * room), 8))
    draw.text((at[0] * scale, at[1] * scale), text, fill=color, font=font, anchor=anchor)
