"""The skeleton is the robot's forward kinematics, nothing else."""

import numpy as np

from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.skeleton import skeleton


def standing(frames: int = 1) -> np.ndarray:
    qpos = np.zeros((frames, 19))
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height, 1.0, spec.NOMINAL_POSE
    return qpos


def yaw(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def test_the_nominal_pose_stands_on_all_feet():
    feet = skeleton(PUPPER_V2, standing()).legs[0, :, 3]
    np.testing.assert_allclose(feet[:, 2], 0.0095, atol=1e-12)
    np.testing.assert_allclose(feet[:, 1], [-0.0805, 0.0805, -0.0805, 0.0805], atol=1e-12)


def test_legs_follow_the_closed_form():
    random = np.random.default_rng(0)
    qpos = standing(20)
    qpos[:, 7:] += random.uniform(-0.5, 0.5, (20, 12))
    qpos[:, 7::3] = 0.0
    legs = skeleton(PUPPER_V2, qpos).legs
    hip, knee = qpos[:, 8::3], qpos[:, 9::3]
    x = -(spec.THIGH_LENGTH * np.sin(hip) + spec.SHANK_LENGTH * np.sin(hip + knee))
    z = -(spec.THIGH_LENGTH * np.cos(hip) + spec.SHANK_LENGTH * np.cos(hip + knee))
    np.testing.assert_allclose(legs[:, :, 3, 0] - legs[:, :, 1, 0], x, atol=1e-12)
    np.testing.assert_allclose(legs[:, :, 3, 2] - legs[:, :, 1, 2], z, atol=1e-12)
    np.testing.assert_allclose(
        legs[:, :, 0] - [0.0, 0.0, PUPPER_V2.standing_height],
        np.broadcast_to([spec.abduction_origin(leg) for leg in spec.LEGS], (20, 4, 3)),
        atol=1e-12,
    )


def test_links_keep_their_lengths():
    random = np.random.default_rng(1)
    qpos = np.concatenate([random.normal(size=(30, 7)), random.uniform(-0.7, 0.7, (30, 12))], axis=1)
    lengths = np.linalg.norm(np.diff(skeleton(PUPPER_V2, qpos).legs, axis=2), axis=-1)
    wanted = [np.linalg.norm(offset) for offset in (spec.HIP_OFFSET, spec.KNEE_OFFSET, spec.FOOT_OFFSET)]
    np.testing.assert_allclose(lengths, np.broadcast_to(wanted, lengths.shape), atol=1e-12)


def test_the_robot_moves_as_one_body():
    still, moved = standing(), standing()
    angle, shift = 0.7, np.array([0.3, -0.2, 0.1])
    moved[0, :3] += shift
    moved[0, 3:7] = np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)
    before, after = skeleton(PUPPER_V2, still), skeleton(PUPPER_V2, moved)
    np.testing.assert_allclose(after.legs[0], before.legs[0] @ yaw(angle).T + shift, atol=1e-12)
    np.testing.assert_allclose(after.chassis[0], before.chassis[0] @ yaw(angle).T + shift, atol=1e-12)


def test_the_chassis_is_the_box_of_the_specification():
    corners = skeleton(PUPPER_V2, standing()).chassis[0]
    np.testing.assert_allclose(np.ptp(corners, axis=0), spec.CHASSIS_BOX_SIZE, atol=1e-12)
    np.testing.assert_allclose(corners[7] - corners[0], spec.CHASSIS_BOX_SIZE, atol=1e-12)
