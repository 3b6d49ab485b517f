"""Films of a walk: MuJoCo's renderer in a process of its own, and its window."""

# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.build_model import build_model
from motorprior.simulation.camera import prepare
from motorprior.simulation.rendering import HEIGHT, WIDTH, rendered


def standing(frames: int) -> np.ndarray:
    qpos = np.zeros((frames, 19))
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height, 1.0, PUPPER_V2.nominal_pose
    return qpos


def test_the_robot_is_in_the_picture_and_moves():
    walk = standing(3)
    walk[1:, 0] = 0.05
    walk[2, 8] += 0.5
    try:
        with rendered(PUPPER_V2.name, [walk, standing(3)]) as frames:
            pictures = list(frames)
    except ConfigError as error:
        pytest.skip(f"no OpenGL: {error.problem}")
    assert [picture.shape for picture in pictures] == [(2 * HEIGHT, WIDTH, 3)] * 3
    upper, lower = (
        np.array([picture[part] for picture in pictures], int) for part in (slice(HEIGHT), slice(HEIGHT, None))
    )

    def apart(one: np.ndarray, other: np.ndarray) -> int:
        return np.abs(one - other).max()

    assert apart(lower[0], lower[1]) < 10 and apart(upper[0], lower[0]) < 10  # a GPU rounds as it likes
    assert apart(upper[0], upper[1]) > 40 and apart(upper[1], upper[2]) > 40


def test_a_robot_of_collision_shapes_alone_is_seen():
    model = build_model(PUPPER_V2)
    for group, shown in ((0, 0), (2, 0), (3, 1)):
        model.geom_group[1:], option = group, mujoco.MjvOption()
        prepare(model, option)
        assert option.geomgroup[3] == shown
    model.geom_group[1] = 0  # one that is shown is enough
    option = mujoco.MjvOption()
    prepare(model, option)
    assert option.geomgroup[3] == 0
