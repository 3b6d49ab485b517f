"""Films of walks, one under the other, as GIF or MP4.

They are rendered by MuJoCo where OpenGL works, and are stick figures elsewhere.
"""

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
from motorprior.progress import Progress, Task
from motorprior.report.plots_style import INK, MUTED
from motorprior.robots.robot import Robot
from motorprior.simulation.rendering import HEIGHT, WIDTH, renderer, skeleton
from motorprior.simulation.scene import Episode
from motorprior.studies.gait_quality import headings, steps_along_heading

RATE = 20.0  # of films [Hz]
_GROUND = 240  # row of the floor in a stick figure [pixel]
_BEHIND = "#b4bac2"  # colour of the legs on the far side
_HEADER = 58  # height of the title [pixel]
_MARGIN = 16  # to the left and right of the title [pixel]


def film(
    robot: Robot, walks: Mapping[str, Episode], steps: int, stride: int, note: Callable[[str], None]
) -> Iterator[Image.Image]:
    """Pictures of the first control steps of walks by title, every ``stride`` steps.

    A robot that falls stays where it fell. A line states time, distance along the heading, and a
    fall. ``note`` gets the reason if stick figures are drawn for lack of OpenGL.
    """
    traces = []
    distances = []  # along the heading [m]
    for episode in walks.values():
        trace = until_end(episode.trace[:steps], steps)
        traces.append(trace)
        steps_forward = steps_along_heading(trace[:, :2], headings(trace))
        distances.append(np.append(0.0, np.cumsum(steps_forward)))

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
                time = step * robot.control_dt
                fell = "fell" if step >= episode.steps else ""
                labelled(picture, title, f"{time:.2f} s    {distances[row][step]:z.2f} m    {fell}")
                whole.paste(picture, (0, row * HEIGHT))
            yield whole


def write_film(
    folder: Path, robot: Robot, walks: Mapping[str, Episode], steps: int, progress: Progress
) -> Path:
    """Write play.gif and, where the encoder is installed, play.mp4, of walks by title.

    Returns the path of the MP4 if there is one, else of the GIF.
    """
    stride = _stride(robot, RATE)
    count = len(range(0, steps, stride))
    seconds = stride * robot.control_dt
    with progress.start(f"film of {count} pictures", count) as task:
        pictures = list(_counted(film(robot, walks, steps, stride, progress.note), task))

    path = folder / "play.gif"
    with atomic_path(path) as temporary:
        temporary.write_bytes(gif_bytes(pictures, seconds))
    if can_write_mp4():
        path = folder / "play.mp4"
        with atomic_path(path) as temporary:
            write_mp4(temporary, pictures, seconds)
    return path


def _counted(pictures: Iterable[Image.Image], task: Task) -> Iterator[Image.Image]:
    """The pictures; each advances the task."""
    for picture in pictures:
        task.advance()
        yield picture


def comparison_gif(
    robot: Robot,
    walks: Mapping[str, Episode],
    steps: int,
    note: Callable[[str], None],
    rate: float = RATE,
) -> bytes:
    """A GIF of a `film` at a rate [Hz]."""
    stride = _stride(robot, rate)
    return gif_bytes(film(robot, walks, steps, stride, note), stride * robot.control_dt)


def _stride(robot: Robot, rate: float) -> int:
    """Control steps from one picture to the next."""
    return max(1, round(1.0 / (rate * robot.control_dt)))


def until_end(trace: np.ndarray, steps: int) -> np.ndarray:
    """The trace of a walk, its last frame repeated up to ``steps``."""
    return np.concatenate([trace, np.repeat(trace[-1:], steps - len(trace), axis=0)])


def gif_bytes(pictures: Iterable[Image.Image], seconds: float) -> bytes:
    """An endless GIF of at least one picture, each shown for ``seconds``.

    The time is rounded to 10 ms, and at least 20 ms.
    """
    rest = iter(pictures)
    first = next(rest).quantize(64, dither=Image.Dither.NONE)
    # all pictures have the colours of the first
    quantized = (picture.quantize(palette=first, dither=Image.Dither.NONE) for picture in rest)
    duration = max(20, round(100 * seconds) * 10)  # [ms]
    out = BytesIO()
    first.save(out, "GIF", save_all=True, append_images=quantized, duration=duration, loop=0)
    return out.getvalue()


def can_write_mp4() -> bool:
    """Whether the encoder is installed: pip install imageio-ffmpeg."""
    return find_spec("imageio_ffmpeg") is not None


def write_mp4(path: Path, pictures: Iterable[Image.Image], seconds: float) -> None:
    """Write an MP4 (H.264) of at least one picture, each shown for ``seconds``."""
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    rest = iter(pictures)
    first = next(rest)
    writer = imageio_ffmpeg.write_frames(
        str(path),
        first.size,
        fps=1.0 / seconds,
        quality=7,
        macro_block_size=2,
        output_params=["-f", "mp4"],  # since a temporary file has another suffix
    )
    writer.send(None)
    try:
        for picture in chain([first], rest):
            writer.send(np.ascontiguousarray(np.asarray(picture)).tobytes())
    finally:
        writer.close()


def stick_figure(robot: Robot) -> Callable[[np.ndarray], np.ndarray]:
    """A `renderer` of a side view from the right, without OpenGL.

    The camera follows the robot; a tick of the floor is 0.1 m.
    """
    lines_of = skeleton(robot)
    scale = 146.0 / robot.standing_height  # [pixel/m]

    def draw(qpos: np.ndarray) -> np.ndarray:
        image = Image.new("RGB", (WIDTH, HEIGHT), "white")
        pen = ImageDraw.Draw(image)
        camera = float(qpos[0])

        # the floor and its ticks
        reach = WIDTH / 2 / scale
        first_tick = int((camera - reach) * 10) - 1
        last_tick = int((camera + reach) * 10) + 1
        for tick in range(first_tick, last_tick + 1):
            x = WIDTH / 2 + (tick / 10 - camera) * scale
            length = 14 if tick % 5 == 0 else 8
            pen.line((x, _GROUND, x, _GROUND + length), fill=MUTED)
        pen.line((0, _GROUND, WIDTH, _GROUND), fill=MUTED, width=2)

        # the left of the robot first, since it is behind
        lines = lines_of(qpos)
        for line in lines[np.argsort(-lines[:, 1, 1])]:
            color = INK if line[1, 1] < qpos[1] else _BEHIND
            ends = [(WIDTH / 2 + (x - camera) * scale, _GROUND - z * scale) for x, _, z in line]
            pen.line(ends, fill=color, width=7)
            pen.circle(ends[1], 5, fill=color)
        return np.asarray(image)

    return draw


def labelled(picture: Image.Image, title: str, note: str) -> None:
    """Write two lines at the top of a picture; long ones get a smaller font."""
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    pen = ImageDraw.Draw(picture)
    pen.rectangle((0, 0, picture.width, _HEADER), fill="white")
    for text, top, size, color in ((title, 11, 18, INK), (note, 36, 15, MUTED)):
        font = ImageFont.truetype(str(path), size)
        share = font.getlength(text) / (picture.width - 2 * _MARGIN)
        if share > 1:
            font = font.font_variant(size=int(size / share))
        pen.text((_MARGIN, top), text, fill=color, font=font)
