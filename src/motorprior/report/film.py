"""Films of one or several walks, one under the other: an endless GIF, or an MP4 where its encoder is installed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from itertools import chain, islice
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from motorprior.report.lettering import write
from motorprior.report.plots_style import INK, MUTED, most_used, with_palette

_PALETTE = 64
_LOOKED_AT = 3
"""Frames whose colours the palette of a GIF is made from."""


def labelled(frame: np.ndarray, titles: Sequence[str], notes: Sequence[str]) -> Image.Image:
    """A rendered frame with a title and a note in the corner of each walk.

    Args:
        frame: (walks · height, width, 3) uint8.
        titles: one per walk.
        notes: one per walk.
    """
    image = Image.fromarray(frame)
    draw, height = ImageDraw.Draw(image), len(frame) // len(titles)
    for walk, (title, note) in enumerate(zip(titles, notes, strict=True)):
        draw.rectangle((0, walk * height, image.width, walk * height + 58), fill="white")
        write(draw, (16, walk * height + 11), title, 18, INK, 1)
        write(draw, (16, walk * height + 36), note, 15, MUTED, 1)
    return image


def stacked(walks: Sequence[Iterable[Image.Image]]) -> Iterator[Image.Image]:
    """The pictures of several walks, one under the other, as long as all have one."""
    for pictures in zip(*walks, strict=False):
        whole = Image.new("RGB", (pictures[0].width, sum(picture.height for picture in pictures)), "white")
        top = 0
        for picture in pictures:
            whole.paste(picture, (0, top))
            top += picture.height
        yield whole


def gif_bytes(pictures: Iterable[Image.Image], seconds: float) -> bytes:
    """An endless GIF.

    Args:
        pictures: at least one; the first few must show every colour that matters.
        seconds: that each is shown [s], rounded to 10 ms and at least 20 ms, as browsers take it.
    """
    rest = iter(pictures)
    first = list(islice(rest, _LOOKED_AT))
    palette, out = most_used(first, _PALETTE), BytesIO()
    flat = (with_palette(picture, palette) for picture in chain(first, rest))
    duration = max(20, round(100 * seconds) * 10)
    next(flat).save(out, "GIF", save_all=True, append_images=flat, duration=duration, loop=0)
    return out.getvalue()


def can_write_mp4() -> bool:
    """Whether the encoder is installed: pip install 'motorprior[video]'."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]
    except ImportError:
        return False
    return bool(imageio_ffmpeg.__version__)


def write_mp4(path: Path, pictures: Iterable[Image.Image], seconds: float) -> None:
    """An MP4 (H.264).

    Args:
        path: the file, overwritten.
        pictures: at least one; sides in multiples of 2 pixels.
        seconds: that each is shown [s].
    """
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    rest = iter(pictures)
    first = next(rest)
    kind = ["-f", "mp4"]  # the name of a half-written file does not say it
    writer = imageio_ffmpeg.write_frames(
        str(path), first.size, fps=1.0 / seconds, quality=7, macro_block_size=2, output_params=kind
    )
    writer.send(None)
    try:
        for picture in chain([first], rest):
            writer.send(np.ascontiguousarray(np.asarray(picture)).tobytes())
    finally:
        writer.close()
