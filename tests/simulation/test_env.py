"""The environment keeps Gymnasium's contract and the stated order of a control step."""

import math

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from motorprior.backend import BackendState
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.body import add_support, advance_phase, body_of, gait_share, joint_targets
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import (
    MAX_HEADING_ERROR,
    MAX_TARGET_SPEED,
    RAMP,
    SPEED_FILTER,
    TaskWeights,
    new_gait,
    observe,
)
from motorprior.locomotion.policy import action_to_command, low_pass
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import JOINT_LOWER, JOINT_UPPER, NOMINAL_POSE
from motorprior.simulation.env import WalkEnv
from motorprior.simulation.scene import WalkConfig

BODY, GLIDE = body_of(PUPPER_V2), 0.3


class GlidingBackend:
    """Joints follow at once, the base glides forward by 3 mm per step; falls or fails on request."""

    def __init__(self, fall_at=10**9, fail_at=10**9):
        self.fall_at, self.fail_at, self.targets = fall_at, fail_at, []

    def reset(self, seed):
        rng = np.random.default_rng(seed)
        self.start, self.count, self.joints = rng.normal(0.0, 0.01, 2), 0, NOMINAL_POSE.copy()
        return self._state()

    def step(self, position_target):
        self.targets.append(position_target)
        self.joints = position_target
        self.count += 1
        return self._state()

    def close(self):
        pass

    def _state(self):
        return BackendState(
            base_pos=np.array([self.start[0] + 0.003 * self.count, self.start[1], 0.17]),
            base_quat=np.array([1.0, 0.0, 0.0, 0.0]) if self.count < self.fall_at else np.array([0.8, 0.6, 0, 0]),
            base_lin_vel=np.array([GLIDE, 0.0, 0.0]),
            base_ang_vel=np.zeros(3),
            measured_joint_pos=self.joints.copy() if self.count < self.fail_at else np.full(12, np.nan),
            foot_pos=np.full((4, 3), np.nan),
            torque_squared_sum=2.0,
            fault=int(self.count >= self.fail_at),
        )


@pytest.mark.filterwarnings("error")
def test_gymnasium_contract():
    check_env(WalkEnv(PUPPER_V2, GlidingBackend(), WalkConfig(20)), skip_render_check=True)


SPEED, TURN = 0.3, 0.2


def test_order_of_a_control_step():
    backend, weights = GlidingBackend(), TaskWeights()
    env = WalkEnv(PUPPER_V2, backend, WalkConfig(commands=Commands.steady(SPEED, TURN)))
    observation, info = env.reset(seed=4)
    rng, filtered, command, path = np.random.default_rng(0), np.zeros(17), np.empty(17), np.empty((2, 12))
    phase, target, twist, state = 0.0, NOMINAL_POSE.copy(), np.zeros(2), new_gait(BODY)
    ramp, filtered_speed, goal = np.array([BODY.max_speed, BODY.max_yaw_rate]) * 0.01 / RAMP, 0.0, 0.0
    for _ in range(150):
        twist = np.minimum(twist + ramp, [SPEED, TURN])  # before the observation
        goal += 0.01 * twist[1]
        np.testing.assert_allclose(info["command"], twist, atol=1e-12)
        share = gait_share(BODY, *twist)
        np.testing.assert_allclose(observation[18:21], [share * max(-goal, -MAX_HEADING_ERROR), *twist], atol=1e-12)
        np.testing.assert_allclose(
            observation[21:], [share * math.cos(2 * math.pi * phase), share * math.sin(2 * math.pi * phase)], atol=1e-12
        )
        action = rng.uniform(-1.5, 1.5, 17)
        observation, earned, terminated, _, info = env.step(action)
        low_pass(action, 0.01, filtered)
        action_to_command(BODY, filtered, command)
        frequency, intensity, height, ratio, turn = command[12:]
        later = advance_phase(phase, frequency, 0.01)
        for row, at in zip(path, (phase, later), strict=True):  # the old phase, and the next for the lead
            gait = BODY, at, intensity * twist[0], intensity * twist[1] + share * turn
            joint_targets(*gait, frequency, height, (0.0, 0.0), ratio, share * BODY.swing_height, row)
        wanted = path[0] + BODY.lead * (path[1] - path[0]) / 0.01 + command[:12]
        add_support(BODY, phase, ratio, share, path[0], wanted)
        target = target + np.clip(wanted - target, -0.01 * MAX_TARGET_SPEED, 0.01 * MAX_TARGET_SPEED)
        target = np.clip(target, JOINT_LOWER, JOINT_UPPER)
        np.testing.assert_allclose(backend.targets[-1], target, atol=1e-12)
        np.testing.assert_array_equal(info["position_target"], backend.targets[-1])
        phase = later
        assert info["phase"] == pytest.approx(phase)
        observe(BODY, backend._state(), state.observation)  # the new state
        np.testing.assert_array_equal(observation[:17], state.observation[:17])
        filtered_speed += (1.0 - math.exp(-0.01 / SPEED_FILTER)) * (GLIDE - filtered_speed)
        wrong = weights.speed * abs(filtered_speed - twist[0]) + weights.heading * goal + weights.yaw_rate * twist[1]
        assert earned == pytest.approx(0.01 * (weights.alive - wrong - 2.0 * weights.torque))
        assert not terminated


def test_a_fall_ends_the_episode_without_the_reward_for_staying_up():
    alone = TaskWeights(speed=0.0, lateral=0.0, heading=0.0, yaw_rate=0.0, tilt=0.0, torque=0.0, slip=0.0)
    env = WalkEnv(PUPPER_V2, GlidingBackend(fall_at=2), WalkConfig(task=alone))
    env.reset(seed=0)
    _, upright, terminated, _, _ = env.step(np.zeros(17))
    _, falling, down, truncated, _ = env.step(np.zeros(17))
    assert not terminated and down and not truncated
    assert (upright, falling) == (pytest.approx(0.01 * alone.alive), 0.0)
    with pytest.raises(ConfigError, match="reset"):
        env.step(np.zeros(17))


def test_a_fault_ends_the_episode_with_a_finite_observation():
    env = WalkEnv(PUPPER_V2, GlidingBackend(fail_at=2))
    env.reset(seed=0)
    before = env.step(np.zeros(17))[0]
    observation, earned, terminated, _, info = env.step(np.zeros(17))
    assert (earned, terminated, info["fault"]) == (0.0, True, 1)
    np.testing.assert_array_equal(observation, before)
    with pytest.raises(SimulationFault):
        WalkEnv(PUPPER_V2, GlidingBackend(fail_at=0)).reset(seed=0)
