"""MJCF and URDF of the Pupper are the same robot, with the published dimensions and masses."""

import mujoco
import numpy as np
import pytest

from motorprior.robots.build_model import build_model
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.urdf import urdf


@pytest.fixture(scope="module")
def model():
    return build_model(PUPPER_V2)


@pytest.fixture(scope="module")
def suspended():
    return build_model(PUPPER_V2, suspended=True)


@pytest.fixture(scope="module")
def bullet(tmp_path_factory):
    """PyBullet and the numbers of the body and of the client.

    The base is free, since a fixed base has no mass.
    """
    pybullet = pytest.importorskip(
        "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
    )
    path = tmp_path_factory.mktemp("robot") / "pupper.urdf"
    path.write_text(urdf(), encoding="utf-8")
    client = pybullet.connect(pybullet.DIRECT)
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    body = pybullet.loadURDF(str(path), flags=flags, physicsClientId=client)
    yield pybullet, body, client
    pybullet.disconnect(client)


def infos(bullet):
    pybullet, body, client = bullet
    count = pybullet.getNumJoints(body, physicsClientId=client)
    return [pybullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]


def poses(count=5):
    return np.random.default_rng(0).uniform(PUPPER_V2.lower, PUPPER_V2.upper, (count, 12))


def feet(model, joint_pos):
    """(4, 3) feet in the chassis' axes [m], LEGS order."""
    data = mujoco.MjData(model)
    data.qpos[-12:] = joint_pos
    mujoco.mj_kinematics(model, data)
    rotation = data.body("chassis").xmat.reshape(3, 3)
    world = np.array([data.geom(f"{leg.name}_foot").xpos for leg in PUPPER_V2.legs])

    return (world - data.body("chassis").xpos) @ rotation


def mass_matrix(suspended, joint_pos):
    """(12, 12) joint-space inertia [kg·m²], column by column."""
    data = mujoco.MjData(suspended)
    columns = np.zeros((12, 12))
    data.qpos[:] = joint_pos
    mujoco.mj_forward(suspended, data)
    for column, unit in zip(columns, np.eye(12), strict=True):
        mujoco.mj_mulM(suspended, data, column, unit)

    return columns


def test_the_feet_touch_the_ground_at_standing_height(model):
    data = mujoco.MjData(model)
    data.qpos[-12:] = PUPPER_V2.nominal_pose
    mujoco.mj_kinematics(model, data)

    assert data.qpos[2] == pytest.approx(0.080 * np.cos(0.6) + 0.110 * np.cos(-0.6) + 0.0095)
    # 0.991 + 4·(0.106 + 0.142 + 0.038 + 0.0001) = 2.1354 kg
    assert mujoco.mj_getTotalmass(model) == pytest.approx(2.135, abs=5e-4)
    for leg in PUPPER_V2.legs:
        assert data.geom(f"{leg.name}_foot").xpos[2] == pytest.approx(0.0095, abs=1e-9)


def test_both_formats_have_the_same_joints_in_the_same_order_with_the_same_limits_and_axes(
    model, bullet
):
    names = [model.joint(i).name for i in range(1, 13)]

    assert names == [info[1].decode() for info in infos(bullet)] == list(PUPPER_V2.joint_names)
    for index, info in enumerate(infos(bullet)):
        np.testing.assert_allclose(info[8:10], model.jnt_range[index + 1], atol=1e-6)
        np.testing.assert_allclose(info[13], model.jnt_axis[index + 1])
        # 7 A · 0.18 N·m/A
        assert info[10] == pytest.approx(1.26)
        assert info[11] == pytest.approx(52.0)
    np.testing.assert_allclose(model.jnt_range[1:, 0], PUPPER_V2.lower)
    np.testing.assert_allclose(model.jnt_range[1:, 1], PUPPER_V2.upper)


def test_both_formats_put_the_feet_at_the_same_place(model, bullet):
    pybullet, body, client = bullet
    center_of_mass, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    base = np.array(center_of_mass) - (0.048, 0.0, -0.00964)

    for pose in poses():
        for joint in range(12):
            pybullet.resetJointState(body, joint, pose[joint], physicsClientId=client)
        for leg, expected in enumerate(feet(model, pose)):
            state = pybullet.getLinkState(
                body, 3 * leg + 2, computeForwardKinematics=True, physicsClientId=client
            )
            rotation = np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
            offset = (0.0, -0.002 if leg % 2 else 0.002, -0.110)
            foot = np.array(state[4]) + rotation @ offset - base
            np.testing.assert_allclose(foot, expected, atol=1e-6)


def test_both_formats_have_the_same_mass_matrix(suspended, bullet):
    pybullet, body, client = bullet
    for pose in poses():
        matrix = np.array(pybullet.calculateMassMatrix(body, pose.tolist(), physicsClientId=client))
        # after the base's six rows; the smallest diagonal element is 3e-4 kg·m²
        np.testing.assert_allclose(matrix[6:, 6:], mass_matrix(suspended, pose), atol=1e-8)
