"""Pictures of a gait from the side: a strip of frames, and a small animation. No OpenGL.

The robot is seen from its right: forward is to the right, its right legs are near, its left legs far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from motorprior.exceptions import ConfigError
from motorprior.locomotion.foot_slip import TOUCHING
from motorprior.report.film import gif_bytes
from motorprior.report.lettering import write
from motorprior.report.plots_style import INK, MUTED, describe, new_figure, style
from motorprior.simulation.skeleton import Skeleton

FACES = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
"""Corners of `Skeleton.chassis` around each face of the box."""
PICTURED = 0.166
"""Height of a base [m] that the pictures are laid out for; a larger robot is drawn smaller."""
FRAMES, SPAN = 6, 0.6
"""Of a strip: how many, and the time from the first to the last [s]."""
RATE = 20.0
"""Of an animation [pictures/s], rounded to a whole number of control steps."""
BODY, FAR_LEG = "#dfe3e8", "#b4bac2"

_SMOOTH = 2  # drawn this many times larger, then averaged down


@dataclass(frozen=True)
class _View:
    """From metres around the camera to pixels of the animation, at full drawing size."""

    metre: float
    """[pixel/m]"""
    width: int = 480
    height: int = 288
    ground: int = 240
    """row of the floor"""

    def pixels(self, points: np.ndarray, camera: float) -> list[tuple[float, float]]:
        """World points (N, 2 or 3), x first and z last [m]; ``camera`` is x in the picture's middle [m]."""
        x = self.width / 2 + (points[:, 0] - camera) * self.metre
        y = self.ground - points[:, -1] * self.metre
        return [(float(a) * _SMOOTH, float(b) * _SMOOTH) for a, b in zip(x, y, strict=True)]


def gait_strip(skeleton: Skeleton, control_dt: float, title: str, *, color: str = INK) -> Figure:
    """The last SPAN seconds as frames side by side; a foot on the ground has a ring.

    Args:
        skeleton: one frame per control step.
        control_dt: time between frames [s].
        title: above the strip.
        color: of the near legs.
    """
    _require_frames(skeleton)
    first = max(0, len(skeleton) - 1 - round(SPAN / control_dt))
    picked = np.unique(np.linspace(first, len(skeleton) - 1, FRAMES).round().astype(int))
    size = skeleton.height / PICTURED
    pitch = 0.40 * size
    figure = new_figure(1.5)
    axes = figure.add_subplot()
    style(axes)
    for column, frame in enumerate(picked):
        middle = skeleton.chassis[frame, :, 0].mean()
        shift = np.array([column * pitch - middle, 0.0, 0.0])
        _draw_frame(axes, skeleton, skeleton.legs[frame] + shift, skeleton.chassis[frame] + shift, color)
    axes.axhline(0.0, color=MUTED, linewidth=1.0, zorder=0)
    labels = [_time_and_place(skeleton, frame, control_dt, "\n") for frame in picked]
    axes.set_xticks(np.arange(len(picked)) * pitch, labels)
    axes.set_yticks([0.0, 0.1, 0.2] if size < 2.0 else [0.0, 0.2, 0.4])
    axes.set(xlim=(-0.6 * pitch, (len(picked) - 0.4) * pitch), ylim=(-0.02 * size, 0.26 * size), aspect="equal")
    axes.grid(False)
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(axis="x", length=0)
    describe(axes, x="time [s] and distance walked [m]", y="height [m]", title=title)
    return figure


def _draw_frame(axes: Axes, skeleton: Skeleton, legs: np.ndarray, chassis: np.ndarray, color: str) -> None:
    """One robot: far legs, body, near legs; (L, 4, 3) and (8, 3) in the axes' coordinates [m]."""
    for leg in _side(skeleton, right=False):
        _strip_leg(axes, legs[leg], skeleton.foot_radius, FAR_LEG, 1)
    for face in FACES:
        axes.fill(chassis[face, 0], chassis[face, 2], color=BODY, linewidth=0, zorder=2)
    for leg in _side(skeleton, right=True):
        _strip_leg(axes, legs[leg], skeleton.foot_radius, color, 3)


def _side(skeleton: Skeleton, right: bool) -> list[int]:
    """Legs of one side; the camera is on the right."""
    return [leg for leg, is_right in enumerate(skeleton.is_right) if is_right is right]


def _strip_leg(axes: Axes, points: np.ndarray, foot_radius: float, color: str, order: int) -> None:
    """A leg (4, 3) [m], with a ring where its foot is on the ground."""
    look = {"color": color, "linewidth": 2.4, "solid_capstyle": "round", "solid_joinstyle": "round"}
    axes.plot(points[:, 0], points[:, 2], zorder=order, **look)
    x, _, z = points[3]
    if z < foot_radius + TOUCHING:
        axes.plot([x], [z], "o", markersize=4, color="white", markeredgecolor=color, zorder=order)


def gait_animation(skeleton: Skeleton, control_dt: float, title: str, *, color: str = INK) -> bytes:
    """An endless GIF in real time; the camera goes along, the ground has a tick every 0.1 m.

    Args:
        skeleton: one frame per control step.
        control_dt: time between frames [s].
        title: written into the picture.
        color: of the near legs.
    """
    _require_frames(skeleton)
    stride = max(1, round(1.0 / (RATE * control_dt)))
    picked = range(0, len(skeleton), stride)
    notes = [_time_and_place(skeleton, frame, control_dt, "    ") for frame in picked]
    return gif_bytes(drawn(skeleton.frames(np.array(picked)), title, notes, color=color), stride * control_dt)


def drawn(skeleton: Skeleton, title: str, notes: Sequence[str], *, color: str = INK) -> Iterator[Image.Image]:
    """A picture of every frame, with a title and a note.

    Args:
        skeleton: the frames.
        title: written into every picture.
        notes: one per frame.
        color: of the near legs.
    """
    _require_frames(skeleton)
    view = _View(880.0 * PICTURED / skeleton.height)
    for frame, note in enumerate(notes):
        yield _picture(view, skeleton, frame, title, note, color)


def _picture(view: _View, skeleton: Skeleton, frame: int, title: str, note: str, color: str) -> Image.Image:
    """One picture of the animation, smoothed."""
    large = Image.new("RGB", (view.width * _SMOOTH, view.height * _SMOOTH), "white")
    draw = ImageDraw.Draw(large)
    legs, chassis = skeleton.legs[frame], skeleton.chassis[frame]
    camera = float(chassis[:, 0].mean())
    _ground(draw, view, camera)
    for leg in _side(skeleton, right=False):
        _leg(draw, view, legs[leg], skeleton.foot_radius, camera, FAR_LEG, 7)
    for face in FACES:
        draw.polygon(view.pixels(chassis[face], camera), fill=BODY)
    for leg in _side(skeleton, right=True):
        _leg(draw, view, legs[leg], skeleton.foot_radius, camera, color, 8)
    write(draw, (16, 11), title, 18, INK, _SMOOTH)
    write(draw, (16, 37), note, 16, MUTED, _SMOOTH)
    return large.reduce(_SMOOTH)


def _leg(
    draw: ImageDraw.ImageDraw,
    view: _View,
    points: np.ndarray,
    foot_radius: float,
    camera: float,
    color: str,
    width: int,
) -> None:
    """A leg (4, 3) with round joints; a foot on the ground has a white middle."""
    path = view.pixels(points, camera)
    thick = width * _SMOOTH
    draw.line(path, fill=color, width=thick)
    for x, y in path[1:]:
        _disc(draw, x, y, thick / 2, color)
    foot = foot_radius * view.metre * _SMOOTH
    _disc(draw, *path[-1], foot, color)
    if points[-1, 2] < foot_radius + TOUCHING:
        _disc(draw, *path[-1], 0.55 * foot, "white")


def _disc(draw: ImageDraw.ImageDraw, x: float, y: float, radius: float, color: str) -> None:
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)


def _ground(draw: ImageDraw.ImageDraw, view: _View, camera: float) -> None:
    """Floor with a tick every 0.1 m and a number every 0.5 m."""
    reach = view.width / 2 / view.metre + 0.1
    draw.rectangle((0, view.ground * _SMOOTH, view.width * _SMOOTH, view.height * _SMOOTH), fill="#f4f5f6")
    for tenth in range(int(np.floor((camera - reach) * 10)), int(np.ceil((camera + reach) * 10)) + 1):
        ((x, y),) = view.pixels(np.array([[tenth / 10, 0.0]]), camera)
        long = tenth % 5 == 0
        length, shade = (14, MUTED) if long else (8, "#b9bec5")
        draw.line((x, y, x, y + length * _SMOOTH), fill=shade, width=_SMOOTH)
        if long:
            write(draw, (x / _SMOOTH, view.ground + 17), f"{tenth / 10:.1f} m", 14, MUTED, _SMOOTH, anchor="ma")
    y = view.ground * _SMOOTH
    draw.line((0, y, view.width * _SMOOTH, y), fill=MUTED, width=2 * _SMOOTH)


def _time_and_place(skeleton: Skeleton, frame: int, control_dt: float, between: str) -> str:
    """Time and distance since the first frame."""
    middle = skeleton.chassis[:, :, 0].mean(axis=1)
    walked = middle[frame] - middle[0]
    return f"{frame * control_dt:.2f} s{between}{walked:z.2f} m"


def _require_frames(skeleton: Skeleton) -> None:
    if not len(skeleton):
        raise ConfigError("the gait has no frames", remedy="give at least one")
