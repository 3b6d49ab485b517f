"""Recorded walks: rendered offscreen, as stick figures, in the viewer; motion of the feet."""

import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, cycle
from typing import Any

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.build_model import FLOOR, build_model
from motorprior.robots.robot import Robot

# size of a picture [pixel], multiples of 16 for video encoders
WIDTH = 480
HEIGHT = 288
SUN = np.array([0.3, -0.25, -1.0])  # direction of the light, from the left of the robot
SHADOW_SIZE = 2048  # of the shadow map [texel]
SHADOW_CLIP = 2.0  # distance from the robot with shadows, relative to the extent of the model
REMEDY = (
    "install EGL (Debian: libegl1 with libgl1-mesa-dri), "
    "or OSMesa (libosmesa6) and set MUJOCO_GL=osmesa"
)


@contextmanager
def renderer(robot: Robot) -> Iterator[Callable[[np.ndarray], np.ndarray]]:
    """A function from a qpos (7 + joints,) to a picture (HEIGHT, WIDTH, 3) uint8.

    Only the calling thread can use it.
    The environment variable MUJOCO_GL (egl, osmesa, glfw) selects the OpenGL library; EGL on Linux
    if not set. ConfigError if OpenGL does not work.
    """
    model = build_model(robot)
    option = mujoco.MjvOption()
    camera = mujoco.MjvCamera()
    set_view_and_light(model, option)
    model.vis.headlight.ambient[:] = 0.35  # the sun of `_add_sun` adds the rest
    model.vis.headlight.diffuse[:] = 0.25
    _look_at(robot, camera)

    default = {"linux": "egl", "darwin": "cgl"}.get(sys.platform, "glfw")
    library = os.environ.get("MUJOCO_GL", "").strip().lower() or default
    try:
        window = importlib.import_module(f"mujoco.{library}").GLContext(WIDTH, HEIGHT)
        window.make_current()
        model.vis.quality.offsamples = 0  # antialiasing doubles the time without a GPU
        model.vis.quality.shadowsize = SHADOW_SIZE
        model.vis.map.shadowclip = SHADOW_CLIP
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    except Exception as error:  # of the loader, PyOpenGL or MuJoCo, depending on what is missing
        problem = f"MuJoCo cannot render with {library} ({error})"
        raise ConfigError(problem, remedy=REMEDY) from error

    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    data = mujoco.MjData(model)
    scene = mujoco.MjvScene(model, maxgeom=10_000)
    view = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)

    def draw(qpos: np.ndarray) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        x, y = (0.0, 0.0) if robot.base == "fixed" else qpos[:2].tolist()
        camera.lookat[:] = x, y, 0.75 * robot.standing_height
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1
        _add_sun(scene, camera)
        _add_floor_lines(scene, x, y, robot)
        mujoco.mjr_render(view, scene, context)
        mujoco.mjr_readPixels(picture, None, view, context)
        return picture[::-1].copy()

    try:
        yield draw
    finally:
        context.free()
        window.free()


def model_size(robot: Robot) -> float:
    """Size of the robot's model [m]."""
    return float(build_model(robot).stat.extent)


def _add_sun(scene: mujoco.MjvScene, camera: Any) -> None:
    """A light from behind and above; its shadows show which feet touch the floor."""
    light = scene.lights[scene.nlight]
    light.id = -1
    light.type = mujoco.mjtLightType.mjLIGHT_SPOT
    light.headlight = 0
    light.texid = -1
    light.dir[:] = SUN / np.linalg.norm(SUN)
    light.pos[:] = camera.lookat - 4.0 * camera.distance * light.dir
    light.diffuse[:] = 0.55
    light.specular[:] = 0.1
    light.ambient[:] = 0.0
    light.castshadow = 1
    light.attenuation[:] = 1.0, 0.0, 0.0
    light.cutoff = 60.0
    light.exponent = 0.0
    light.range = 100.0 * camera.distance
    light.bulbradius = 0.0
    scene.nlight += 1


def _look_at(robot: Robot, camera: Any) -> None:
    """Set an MjvCamera to the right of the robot, slightly in front and above."""
    camera.distance = 7.5 * robot.standing_height
    camera.azimuth = 105.0
    camera.elevation = -20.0


def set_view_and_light(model: mujoco.MjModel, option: Any) -> None:
    """Set view and light of a model; show all geom groups if no geom were visible by default."""
    model.vis.global_.fovy = 30.0  # [deg]; keeps the horizon outside the picture
    model.vis.headlight.ambient[:] = 0.4 if model.nlight else 0.6
    model.vis.headlight.diffuse[:] = 0.5 if model.nlight else 0.8

    robot_geoms = np.arange(model.ngeom) != model.geom(FLOOR).id
    # MuJoCo shows groups 0 to 2; models often keep collision shapes in group 3, next to visible
    # meshes
    if not (model.geom_group[robot_geoms] < 3).any():
        option.geomgroup[:] = 1


def _add_floor_lines(scene: mujoco.MjvScene, x: float, y: float, robot: Robot) -> None:
    """Draw lines across the floor, every fifth dark, to make the motion visible."""
    # 0.1 m for a robot of 0.166 m, 1 m for a ten times larger one
    gap = 0.1 * 10.0 ** round(np.log10(robot.standing_height / 0.166))
    reach = 10.0 * robot.standing_height
    middle = round(x / gap)
    count = round(reach / gap)
    box = mujoco.mjtGeom.mjGEOM_BOX
    for line in range(middle - count, middle + count + 1):
        is_dark = line % 5 == 0
        shade = 0.45 if is_dark else 0.75
        width = 0.04 if is_dark else 0.02
        size = [width * gap, reach, 0.01 * gap]
        center = [line * gap, y, 0.0]
        color = np.array([shade, shade, shade, 1.0], np.float32)
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], box, size, center, np.eye(3).ravel(), color)
        scene.ngeom += 1


def skeleton(robot: Robot) -> Callable[[np.ndarray], np.ndarray]:
    """A function from a qpos (7 + joints,) to the ends (N, 2, 3) of N lines [m].

    The first lines are between bodies of the model, the last ones to the feet.
    """
    model = build_model(robot)
    data = mujoco.MjData(model)
    bodies = np.array([body for body in range(1, model.nbody) if model.body_parentid[body]])
    parents = model.body_parentid[bodies]
    feet = np.array([model.geom(leg.foot).id for leg in robot.legs], dtype=int)

    def lines(qpos: np.ndarray) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        links = np.stack([data.xpos[parents], data.xpos[bodies]], axis=1)
        soles = np.stack([data.xpos[model.geom_bodyid[feet]], data.geom_xpos[feet]], axis=1)
        return np.concatenate([links, soles])

    return lines


def show(robot: Robot, walks: Sequence[np.ndarray], control_dt: float) -> None:
    """Play walks (F, 7 + joints) repeatedly, with ``control_dt`` [s] between frames.

    It returns when the window is closed. ConfigError if no window can be opened.
    """
    import mujoco.viewer  # here, since it needs a screen

    model = build_model(robot)
    data = mujoco.MjData(model)
    try:
        opened = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except Exception as error:  # of GLFW, MuJoCo or Python, depending on the system
        problem = f"viewer: no window ({error})"
        remedy = "omit it: the film in the output folder shows the same"
        remedy += "; on macOS start it with mjpython"
        raise ConfigError(problem, remedy=remedy, argument="viewer") from error

    with opened as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = 1
        _look_at(robot, window.cam)
        set_view_and_light(model, window.opt)

        for frame in cycle(chain.from_iterable(walks)):
            if not window.is_running():
                return
            began = time.monotonic()
            with window.lock():
                data.qpos[:] = frame
                mujoco.mj_forward(model, data)
            window.sync()
            time.sleep(max(0.0, began + control_dt - time.monotonic()))


def foot_motion(robot: Robot, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height (F, L) [m] and horizontal speed (F, L) [m/s] of the feet's lowest points.

    F frames of L feet are given by qpos (F, 7 + joints) and qvel (F, 6 + joints). The lowest point
    of a foot of radius r moves with v + ω × (0, 0, -r): a foot that rolls does not slide.
    """
    model = build_model(robot)
    data = mujoco.MjData(model)
    velocity = np.zeros(6)
    feet = [(model.geom(leg.foot).id, leg.foot_radius) for leg in robot.legs]
    clearance = np.zeros((len(qpos), len(feet)))
    sliding = np.zeros((len(qpos), len(feet)))

    for frame in range(len(qpos)):
        data.qpos[:] = qpos[frame]
        data.qvel[:] = qvel[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)

        for column, (geom, radius) in enumerate(feet):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, velocity, 0)
            clearance[frame, column] = data.geom_xpos[geom, 2] - radius
            forward = velocity[3] - velocity[1] * radius
            left = velocity[4] + velocity[0] * radius
            sliding[frame, column] = np.hypot(forward, left)
    return clearance, sliding
