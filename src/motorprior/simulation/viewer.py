"""Walks in MuJoCo's viewer, in real time, where there is a screen."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.simulation.rendering import look_at, set_view_and_light


def require_screen() -> None:
    """Raise ConfigError if there is no screen."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ConfigError(
            "viewer: there is no screen (neither DISPLAY nor WAYLAND_DISPLAY is set)",
            remedy="omit it: the film in the output folder shows the same", argument="viewer",
        )  # fmt: skip


def show(robot: Robot, walks: Sequence[np.ndarray], control_dt: float) -> None:
    """Play walks (F, 7 + joints), with ``control_dt`` [s] between frames, repeatedly until the window is closed.

    Raises:
        ConfigError: no window can be opened.
    """
    import mujoco.viewer  # here, since it needs a screen

    model = build_model(robot)
    data = mujoco.MjData(model)
    try:
        opened = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except Exception as error:  # of GLFW, MuJoCo or Python, depending on the system
        remedy = "on macOS start it with mjpython; or omit it: the film in the output folder shows the same"
        raise ConfigError(f"viewer: no window ({error})", remedy=remedy, argument="viewer") from error
    with opened as window:
        window.cam.type, window.cam.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, 1
        look_at(robot, window.cam)
        set_view_and_light(model, window.opt)
        while window.is_running():
            for walk in walks:
                _play(window, model, data, walk, control_dt)


def _play(window: Any, model: mujoco.MjModel, data: mujoco.MjData, walk: np.ndarray, control_dt: float) -> None:
    """Play one walk until it ends or the window is closed; late frames are skipped."""
    started, frame = time.monotonic(), 0
    while frame < len(walk) and window.is_running():
        with window.lock():
            data.qpos[:] = walk[frame]
            mujoco.mj_forward(model, data)
        window.sync()
        time.sleep(max(0.0, started + (frame + 1) * control_dt - time.monotonic()))
        frame = max(frame + 1, int((time.monotonic() - started) / control_dt))
