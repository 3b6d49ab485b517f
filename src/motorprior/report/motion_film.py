"""A film of a planned motion: the robot's model at its targets."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from motorprior.artifacts import atomic_path
from motorprior.exceptions import ConfigError
from motorprior.progress import Progress, Task
from motorprior.report.film import can_write_mp4, gif_bytes, labelled, stick_figure, write_mp4
from motorprior.robots.robot import Robot
from motorprior.robots.servos import MotionPart
from motorprior.simulation.rendering import model_size, renderer

_RATE = 5.0  # pictures per second of motion [Hz]
_SPEED = 2.0  # of the film over that of the motion [-]
_VIEW = 0.65  # size of the robot in the picture, as a height over its size [-]


def write_motion_film(
    folder: Path, robot: Robot, parts: Sequence[MotionPart], period: float, progress: Progress
) -> Path:
    """Write plan.mp4, or plan.gif where the encoder is not installed; returns its path.

    Targets are ``period`` [s] apart. The film is twice as fast as the motion.
    """
    as_mp4 = can_write_mp4()
    path = folder / ("plan.mp4" if as_mp4 else "plan.gif")
    stride = max(1, round(1.0 / (_RATE * period)))
    count = sum(len(part.targets[::stride]) for part in parts)
    seconds = stride * period / _SPEED

    folder.mkdir(parents=True, exist_ok=True)
    with progress.start(f"film of {count} pictures", count) as task, atomic_path(path) as temporary:
        pictures = _pictures(robot, parts, stride, period, progress, task)
        if as_mp4:
            write_mp4(temporary, pictures, seconds)
        else:
            temporary.write_bytes(gif_bytes(pictures, seconds))
    return path


def _pictures(
    robot: Robot,
    parts: Sequence[MotionPart],
    stride: int,
    period: float,
    progress: Progress,
    task: Task,
) -> Iterator[Image.Image]:
    framed = robot
    base: list[float] = []
    if robot.base == "fixed":
        framed = replace(robot, standing_height=_VIEW * model_size(robot))
    else:
        base = [0.0, 0.0, robot.suspended_height, 1.0, 0.0, 0.0, 0.0]
    with ExitStack() as stack:
        try:
            draw = stack.enter_context(renderer(framed))
        except ConfigError as error:
            progress.note(f"{error.problem}: the film has stick figures -> {error.remedy}")
            draw = stick_figure(framed)
        for part in parts:
            for step in range(0, len(part.targets), stride):
                qpos = np.concatenate([base, part.targets[step]])
                picture = Image.fromarray(draw(qpos))
                labelled(picture, part.name, f"{step * period:.1f} s")
                task.advance()
                yield picture
