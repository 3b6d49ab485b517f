"""The camera shows the robot, and stick figures are its kinematics."""

# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np

from motorprior.robots.build_model import build_model
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rendering import set_view_and_light, skeleton


def test_a_robot_of_collision_shapes_alone_is_visible():
    model = build_model(PUPPER_V2)
    for group, shown in ((0, 0), (2, 0), (3, 1)):
        model.geom_group[1:], option = group, mujoco.MjvOption()
        set_view_and_light(model, option)
        assert option.geomgroup[3] == shown


def test_links_keep_their_lengths():
    random, lines = np.random.default_rng(1), skeleton(PUPPER_V2)
    qpos = np.concatenate([random.normal(size=(30, 7)), random.uniform(-0.7, 0.7, (30, 12))], axis=1)
    found = np.array([np.linalg.norm(np.diff(lines(row), axis=1), axis=-1)[:, 0] for row in qpos])
    for offset in ((-0.02725, 0.0395, 0.0), (0.0, -0.004, -0.080), (0.0, -0.002, -0.110)):  # hip, knee, foot
        assert ((np.abs(found - np.linalg.norm(offset)) < 1e-9).sum(axis=1) >= 4).all()
    np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), atol=1e-9)


def test_the_robot_stands_on_its_feet():
    qpos = np.array([0.0, 0.0, PUPPER_V2.standing_height, 1.0, 0.0, 0.0, 0.0, *spec.NOMINAL_POSE])
    feet = skeleton(PUPPER_V2)(qpos)[-4:, 1]
    np.testing.assert_allclose(feet[:, 2], 0.0095, atol=1e-12)
    np.testing.assert_allclose(feet[:, 1], [-0.0805, 0.0805, -0.0805, 0.0805], atol=1e-12)
