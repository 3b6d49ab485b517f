"""The environment keeps Gymnasium's contract; a fall and a fault end an episode."""

import numpy as np
import pytest
from drawn_motors import draw_pd

from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.control_step import RobotState, TaskWeights
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import Scene, WalkConfig, WalkEnv


class GlidingWorld:
    """A world whose joints follow at once and whose base glides forward by 3 mm per step.

    It falls at step ``fall_at`` and has a fault at step ``fail_at``.
    """

    def __init__(self, fall_at=10**9, fail_at=10**9):
        self.fall_at = fall_at
        self.fail_at = fail_at

    def reset(self, actuator, joint_pos=None, domain=None):
        self.count = 0
        self.joints = PUPPER_V2.nominal_pose.copy()
        return self

    def step(self, target):
        self.joints = target
        self.count += 1
        return self.state()

    def state(self):
        base_quat = np.array([1.0, 0.0, 0.0, 0.0])
        joint_pos = self.joints.copy()
        if self.count >= self.fall_at:
            base_quat = np.array([0.8, 0.6, 0.0, 0.0])  # a roll of 74°
        if self.count >= self.fail_at:
            joint_pos = np.full(12, np.nan)

        return RobotState(
            base_pos=np.array([0.003 * self.count, 0.0, 0.17]),
            base_quat=base_quat,
            base_lin_vel=np.array([0.3, 0.0, 0.0]),
            base_ang_vel=np.zeros(3),
            measured_joint_pos=joint_pos,
            foot_pos=np.full((4, 3), np.nan),
            torque_squared_sum=2.0,
            fault=int(self.count >= self.fail_at),
        )


def env_of(walk=WalkConfig(), **ends):  # noqa: B008
    env = WalkEnv(Scene(PUPPER_V2, draw_pd, walk))
    env.world = GlidingWorld(**ends)  # pyright: ignore[reportAttributeAccessIssue]
    return env


def test_a_fall_ends_the_episode_without_the_reward_for_staying_up():
    only_alive = TaskWeights(
        speed=0.0, lateral=0.0, heading=0.0, yaw_rate=0.0, tilt=0.0, torque=0.0, slip=0.0
    )
    env = env_of(WalkConfig(task=only_alive), fall_at=2)
    env.reset(seed=0)

    _, reward, terminated, _, _ = env.step(np.zeros(17))
    assert reward == pytest.approx(0.01 * only_alive.alive) and not terminated

    _, reward, terminated, truncated, _ = env.step(np.zeros(17))
    assert reward == 0.0 and terminated and not truncated

    with pytest.raises(ConfigError, match="reset"):
        env.step(np.zeros(17))


def test_a_fault_ends_the_episode_with_a_finite_observation():
    env = env_of(fail_at=2)
    env.reset(seed=0)

    last_observation = env.step(np.zeros(17))[0]
    observation, reward, terminated, _, info = env.step(np.zeros(17))
    assert reward == 0.0 and terminated and info["fault"] == 1
    np.testing.assert_array_equal(observation, last_observation)


def test_a_fault_at_reset_is_an_error():
    with pytest.raises(SimulationFault):
        env_of(fail_at=0).reset(seed=0)
