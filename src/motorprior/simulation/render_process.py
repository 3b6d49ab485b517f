"""``python -m motorprior.simulation.render_process REQUEST``: pictures of walks by MuJoCo, as bytes on stdout.

A process of its own, because an OpenGL that is half installed may end the process that asks it for a window. The
robots of several walks stand one under the other in every picture.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np

from motorprior.artifacts import read_tensors
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.build_model import build_model
from motorprior.simulation.camera import look_at, prepare

_GAP = 0.1
"""Distance of the lines on the floor [m]; every fifth is dark. Ten times as much for a robot ten times as high."""
_HEIGHT = 0.166
"""Height of a robot [m] whose floor has lines in that distance."""


def main() -> None:
    """Write frames (walks · height, width, 3) uint8 of the walks "0", "1", … (F, 7 + joints) in a file of tensors."""
    walks, header = read_tensors(Path(sys.argv[1]))
    robot = load_robot(header["robot"])
    model = build_model(robot)
    model.vis.quality.offsamples = 0  # smooth edges cost as much again without a GPU
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    prepare(model, option)
    with mujoco.Renderer(model, header["height"], header["width"]) as renderer:
        for frame in range(len(walks["0"])):
            for walk in range(len(walks)):
                data.qpos[:] = walks[str(walk)][frame]
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, _camera(robot, data.qpos), option)
                renderer.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
                _lines(renderer.scene, float(data.qpos[0]), float(data.qpos[1]), robot)
                sys.stdout.buffer.write(renderer.render().tobytes())
    sys.stdout.buffer.flush()


def _camera(robot: Robot, qpos: np.ndarray) -> mujoco.MjvCamera:
    """From the robot's right and above; it goes along and does not turn."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = qpos[0], qpos[1], 0.75 * robot.standing_height
    look_at(robot, camera)
    return camera


def _lines(scene: mujoco.MjvScene, x: float, y: float, robot: Robot) -> None:
    """Lines across the way: a floor of one colour would hide that the robot moves."""
    gap = _GAP * 10.0 ** round(np.log10(robot.standing_height / _HEIGHT))
    reach, middle = 10.0 * robot.standing_height, round(x / gap)
    count = round(reach / gap)
    for line in range(middle - count, middle + count + 1):
        shade = 0.45 if line % 5 == 0 else 0.75
        geom = scene.geoms[scene.ngeom]
        size = np.array([0.02 * gap if line % 5 else 0.04 * gap, reach, 0.01 * gap])
        place, colour = np.array([line * gap, y, 0.0]), np.array([shade, shade, shade, 1.0])
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, place, np.eye(3).ravel(), colour.astype(np.float32))
        scene.ngeom += 1


if __name__ == "__main__":
    main()
