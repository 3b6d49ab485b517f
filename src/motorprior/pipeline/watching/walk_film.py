"""The film of one or several walks: rendered where OpenGL works, drawn as lines elsewhere; MP4, or GIF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from motorprior.artifacts import atomic_path
from motorprior.exceptions import ConfigError
from motorprior.pipeline.progress import Progress
from motorprior.robots.load import load_robot
from motorprior.simulation.rendering import rendered
from motorprior.simulation.skeleton import skeleton

if TYPE_CHECKING:
    from PIL import Image

Look = Literal["auto", "rendered", "drawn"]
_GIF_RATE, _MP4_RATE = 20.0, 25.0
"""Pictures per second of walking."""


@dataclass(frozen=True, eq=False)
class Scenes:
    """What a film shows, one walk under the other, a frame per control step and as many of each.

    Attributes:
        robot: name, or path of its .toml file.
        walks: (F, 7 + joints) of each, base pose and joint angles.
        titles: of each.
        notes: (F,) of each.
    """

    robot: str
    walks: list[np.ndarray]
    titles: list[str]
    notes: list[list[str]]

    def every(self, stride: int) -> Scenes:
        """Every so many frames."""
        walks, notes = [walk[::stride] for walk in self.walks], [note[::stride] for note in self.notes]
        return Scenes(self.robot, walks, self.titles, notes)


def write_film(folder: Path, scenes: Scenes, look: Look, progress: Progress) -> Path:
    """Write play.mp4, or play.gif where the encoder is not installed; returns its path.

    Raises:
        ConfigError: a rendered film is asked for, and there is no OpenGL.
        ArtifactError: the file cannot be written.
    """
    from motorprior.report import film  # here: it imports matplotlib, a second that nothing else needs

    as_mp4, control_dt = film.can_write_mp4(), load_robot(scenes.robot).control_dt
    path = folder / ("play.mp4" if as_mp4 else "play.gif")
    stride = max(1, round(1.0 / ((_MP4_RATE if as_mp4 else _GIF_RATE) * control_dt)))
    scenes = scenes.every(stride)
    with (
        progress.start(f"film of {len(scenes.walks[0])} pictures", len(scenes.walks[0])) as task,
        _pictures(scenes, look, progress) as pictures,
        atomic_path(path) as temporary,
    ):
        counted = (picture for picture in pictures if task.advance() is None)
        if as_mp4:
            film.write_mp4(temporary, counted, stride * control_dt)
        else:
            temporary.write_bytes(film.gif_bytes(counted, stride * control_dt))
    return path


@contextmanager
def _pictures(scenes: Scenes, look: Look, progress: Progress) -> Iterator[Iterator[Image.Image]]:
    """The frames of the film, the walks one under the other."""
    from motorprior.report.film import labelled, stacked
    from motorprior.report.gait_picture import drawn

    with ExitStack() as stack:
        if look != "drawn":
            try:
                frames = stack.enter_context(rendered(scenes.robot, scenes.walks))
            except ConfigError as error:
                if look == "rendered":
                    raise
                progress.note(f"note: {error.problem}: the film is drawn as lines")
            else:
                each = zip(frames, zip(*scenes.notes, strict=True), strict=True)
                yield (labelled(frame, scenes.titles, notes) for frame, notes in each)
                return
        robot = load_robot(scenes.robot)
        shown = zip(scenes.walks, scenes.titles, scenes.notes, strict=True)
        yield stacked([drawn(skeleton(robot, walk), title, notes) for walk, title, notes in shown])
