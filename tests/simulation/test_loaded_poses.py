"""Poses in which gravity loads the joints of an arm."""

import mujoco
import numpy as np

from motorprior.excitation.servo_motion import motion_range
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.robots.so101.robot import SO101
from motorprior.simulation.loaded_poses import loaded_poses

MOTION = motion_range(SO101.joint_names, SO101.lower, SO101.upper, SO101.nominal_pose, 0.5)
LOADED = {"shoulder_lift": 0.75, "elbow_flex": 0.4, "wrist_flex": 0.1}  # smallest ranges [N·m]


def poses(free_space: float | None = None) -> np.ndarray:
    return loaded_poses(
        SO101, MOTION.lowest, MOTION.highest, MOTION.center, MOTION.reach, free_space
    )


def gravity_range(robot: Robot, pose: np.ndarray, joint: int) -> float:
    """Range of the torque of gravity on a joint that moves about a pose [N·m], by MuJoCo."""
    model = build_model(robot)
    data = mujoco.MjData(model)
    torques = []
    for away in np.linspace(-MOTION.reach[joint], MOTION.reach[joint], 21):
        data.qpos[:] = pose
        data.qpos[joint] += away
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_bias[joint])
    return float(np.ptp(torques))


def test_gravity_changes_most_in_the_pose_of_a_joint():
    for joint, (name, pose) in enumerate(zip(SO101.joint_names, poses(), strict=True)):
        nominal = gravity_range(SO101, MOTION.center, joint)
        if name in LOADED:
            assert gravity_range(SO101, pose, joint) > max(LOADED[name], 1.2 * nominal)
        else:  # no pose loads it: it stays, which takes no time
            np.testing.assert_array_equal(pose, MOTION.center)


def test_poses_are_between_the_limits_and_the_same_in_every_run():
    first = poses()

    assert (first >= MOTION.lowest - 1e-9).all()
    assert (first <= MOTION.highest + 1e-9).all()
    np.testing.assert_array_equal(first, poses())


def test_without_free_space_joints_stay_in_the_nominal_pose():
    np.testing.assert_array_equal(poses(free_space=0.3), np.tile(MOTION.center, (6, 1)))


def test_few_poses_serve_all_joints():
    assert len(np.unique(poses(), axis=0)) <= 4
