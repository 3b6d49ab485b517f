"""Films of walks, one under the other: rendered by MuJoCo where OpenGL works, else stick figures; GIF or MP4."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from importlib.util import find_spec
from io import BytesIO
from itertools import chain
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from motorprior.artifacts import atomic_path
from motorprior.exceptions import ConfigError
from motorprior.progress import Progress
from motorprior.report.plots_style import INK, MUTED
from motorprior.robots.robot import Robot
from motorprior.simulation.rendering import HEIGHT, WIDTH, renderer, skeleton
from motorprior.simulation.scene import Episode
from motorprior.studies.gait_quality import headings, steps_along_heading

_GROUND = 240  # row of the floor in a stick figure


def film(
    robot: Robot, walks: Mapping[str, Episode], steps: int, stride: int, note: Callable[[str], None]
) -> Iterator[Image.Image]:
    """Pictures of the first control steps of walks by title, every ``stride`` steps; a robot that falls stays there.

    A line states time, distance along the heading, and a fall. ``note`` gets the reason if stick
    figures are drawn for lack of OpenGL.
    """
    traces = [until_end(episode.trace[:steps], steps) for episode in walks.values()]
    distances = [
        np.append(0.0, np.cumsum(steps_along_heading(each[:, :2], headings(each))))
        for each in traces
    ]
    with ExitStack() as stack:
        try:
            draw = stack.enter_context(renderer(robot))
        except ConfigError as error:
            note(f"{error.problem}: the film has stick figures -> {error.remedy}")
            draw = stick_figure(robot)
        for step in range(0, steps, stride):
            whole = Image.new("RGB", (WIDTH, len(walks) * HEIGHT))
            for row, (title, episode) in enumerate(walks.items()):
                picture = Image.fromarray(draw(traces[row][step]))
                fell = "fell" if step >= episode.steps else ""
                _label(
                    picture,
                    title,
                    f"{step * robot.control_dt:.2f} s    {distances[row][step]:z.2f} m    {fell}",
                )
                whole.paste(picture, (0, row * HEIGHT))
            yield whole


def write_film(
    folder: Path, robot: Robot, walks: Mapping[str, Episode], steps: int, progress: Progress
) -> Path:
    """Write play.mp4, or play.gif where the encoder is not installed, of walks by title; returns its path."""
    as_mp4 = can_write_mp4()
    path, rate = (folder / "play.mp4", 25.0) if as_mp4 else (folder / "play.gif", 20.0)
    stride = _stride(robot, rate)
    count = len(range(0, steps, stride))
    seconds = stride * robot.control_dt
    with progress.start(f"film of {count} pictures", count) as task, atomic_path(path) as temporary:
        pictures = film(robot, walks, steps, stride, progress.note)
        counted = (picture for picture in pictures if task.advance() is None)
        if as_mp4:
            write_mp4(temporary, counted, seconds)
        else:
            temporary.write_bytes(gif_bytes(counted, seconds))
    return path


def comparison_gif(
    robot: Robot,
    walks: Mapping[str, Episode],
    steps: int,
    note: Callable[[str], None],
    rate: float = 5.0,
) -> bytes:
    """A GIF of a `film` at a rate [Hz]."""
    stride = _stride(robot, rate)
    return gif_bytes(film(robot, walks, steps, stride, note), stride * robot.control_dt)


def _stride(robot: Robot, rate: float) -> int:
    return max(1, round(1.0 / (rate * robot.control_dt)))


def until_end(trace: np.ndarray, steps: int) -> np.ndarray:
    """The trace of a walk, its last frame repeated up to ``steps``."""
    return np.concatenate([trace, np.repeat(trace[-1:], steps - len(trace), axis=0)])


def gif_bytes(pictures: Iterable[Image.Image], seconds: float) -> bytes:
    """An endless GIF of at least one picture, each shown for ``seconds``, rounded to 10 ms and at least 20 ms."""
    rest = iter(pictures)
    first = next(rest).quantize(64, dither=Image.Dither.NONE)
    flat = (picture.quantize(palette=first, dither=Image.Dither.NONE) for picture in rest)
    out = BytesIO()
    duration = max(20, round(100 * seconds) * 10)
    first.save(out, "GIF", save_all=True, append_images=flat, duration=duration, loop=0)
    return out.getvalue()


def can_write_mp4() -> bool:
    """Whether the encoder is installed: pip install 'motorprior[video]'."""
    return find_spec("imageio_ffmpeg") is not None


def write_mp4(path: Path, pictures: Iterable[Image.Image], seconds: float) -> None:
    """An MP4 (H.264) of at least one picture, each shown for ``seconds``; the file is overwritten."""
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    rest = iter(pictures)
    first = next(rest)
    writer = imageio_ffmpeg.write_frames(
        str(path),
        first.size,
        fps=1.0 / seconds,
        quality=7,
        macro_block_size=2,
        output_params=["-f", "mp4"],
    )  # the format is given, since a temporary file has another suffix
    writer.send(None)
    try:
        for picture in chain([first], rest):
            writer.send(np.ascontiguousarray(np.asarray(picture)).tobytes())
    finally:
        writer.close()


def stick_figure(robot: Robot) -> Callable[[np.ndarray], np.ndarray]:
    """A `renderer` of a side view from the right, without OpenGL; the camera follows the robot, a tick is 0.1 m."""
    # [pixel/m]
    lines = skeleton(robot)
    scale = 146.0 / robot.standing_height

    def draw(qpos: np.ndarray) -> np.ndarray:
        image = Image.new("RGB", (WIDTH, HEIGHT), "white")
        pen = ImageDraw.Draw(image)
        camera = float(qpos[0])
        reach = WIDTH / 2 / scale
        for tick in range(int((camera - reach) * 10) - 1, int((camera + reach) * 10) + 2):
            x = WIDTH / 2 + (tick / 10 - camera) * scale
            pen.line((x, _GROUND, x, _GROUND + (14 if tick % 5 == 0 else 8)), fill=MUTED)
        pen.line((0, _GROUND, WIDTH, _GROUND), fill=MUTED, width=2)
        found = lines(qpos)
        # the left of the robot first, since it is behind
        for line in found[np.argsort(-found[:, 1, 1])]:
            color = INK if line[1, 1] < qpos[1] else "#b4bac2"
            ends = [(WIDTH / 2 + (x - camera) * scale, _GROUND - z * scale) for x, _, z in line]
            pen.line(ends, fill=color, width=7)
            pen.circle(ends[1], 5, fill=color)
        return np.asarray(image)

    return draw


def _label(picture: Image.Image, title: str, note: str) -> None:
    pen = ImageDraw.Draw(picture)
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    pen.rectangle((0, 0, picture.width, 58), fill="white")
    for text, top, size, color in ((title, 11, 18, INK), (note, 36, 15, MUTED)):
        font = ImageFont.truetype(str(path), size)
        width = font.getlength(text) / (picture.width - 32)
        pen.text(
            (16, top),
            text,
            fill=color,
            font=font if width <= 1 else font.font_variant(size=int(size / width)),
        )
