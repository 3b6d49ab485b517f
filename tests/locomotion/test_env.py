"""The environment keeps Gymnasium's contract and the stated order of a control step."""

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from motorprior.backend import BackendState
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.body import body_of
from motorprior.locomotion.control_step import accumulate_moments, command_step, evaluate_step
from motorprior.locomotion.env import WalkEnv
from motorprior.locomotion.policy import action_to_command, low_pass
from motorprior.locomotion.task import TaskWeights, observe
from motorprior.locomotion.trajectory_generator import advance_phase, joint_targets
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import JOINT_LOWER, JOINT_UPPER, NOMINAL_POSE

BODY = body_of(PUPPER_V2)


class GlidingBackend:
    """Joints follow at once, the base glides forward by 3 mm per step; falls or fails on request."""

    def __init__(self, fall_at=10**9, fail_at=10**9):
        self.fall_at, self.fail_at, self.targets, self.seeds, self.closed = fall_at, fail_at, [], [], False

    def reset(self, seed):
        rng = np.random.default_rng(seed)
        self.seeds.append(seed)
        self.start, self.count, self.joints = rng.normal(0.0, 0.01, 2), 0, NOMINAL_POSE.copy()
        return self._state()

    def step(self, position_target):
        self.targets.append(position_target)
        self.joints = position_target
        self.count += 1
        return self._state()

    def close(self):
        self.closed = True

    def _state(self):
        return BackendState(
            base_pos=np.array([self.start[0] + 0.003 * self.count, self.start[1], 0.17]),
            base_quat=np.array([1.0, 0.0, 0.0, 0.0]) if self.count < self.fall_at else np.array([0.8, 0.6, 0, 0]),
            base_lin_vel=np.zeros(3),
            base_ang_vel=np.zeros(3),
            measured_joint_pos=self.joints.copy() if self.count < self.fail_at else np.full(12, np.nan),
            torque_squared_sum=2.0,
            fault=int(self.count >= self.fail_at),
        )


@pytest.mark.filterwarnings("error")
def test_gymnasium_contract():
    check_env(WalkEnv(PUPPER_V2, GlidingBackend(), episode_steps=20), skip_render_check=True)


def test_order_of_a_control_step():
    backend = GlidingBackend()
    env = WalkEnv(PUPPER_V2, backend)
    env.reset(seed=4)
    rng = np.random.default_rng(0)
    filtered, command, target, expected = np.zeros(16), np.empty(16), np.empty(12), np.empty(18)
    phase, weights = 0.0, TaskWeights()
    for _ in range(150):
        action = rng.uniform(-1.5, 1.5, 16)
        observation, earned, terminated, _, info = env.step(action)
        low_pass(action, 0.01, filtered)
        action_to_command(filtered, BODY.residual, command)
        joint_targets(BODY, phase, command[13], command[14], command[15], target)  # the old phase
        target = np.clip(target + command[:12], JOINT_LOWER, JOINT_UPPER)
        np.testing.assert_array_equal(backend.targets[-1], target)
        np.testing.assert_array_equal(info["position_target"], target)
        phase = advance_phase(phase, command[12], 0.01)
        observe(np.array([1.0, 0, 0, 0]), np.zeros(3), target, phase, NOMINAL_POSE, expected)  # the new phase and state
        np.testing.assert_array_equal(observation, expected)
        assert earned == pytest.approx(0.003 + weights.alive - 2.0 * weights.torque)
        assert not terminated


def test_the_loop_over_the_two_compiled_functions_gives_the_same_bytes():
    env, backend = WalkEnv(PUPPER_V2, GlidingBackend()), GlidingBackend()
    observation, _ = env.reset(seed=1)
    state = backend.reset(1)
    filtered, command, target, seen = np.zeros(16), np.zeros(16), np.zeros(12), np.zeros(18)
    phase, weights = 0.0, TaskWeights().array()
    observe(state.base_quat, state.base_ang_vel, state.measured_joint_pos, phase, NOMINAL_POSE, seen)
    for step in range(60):
        assert observation.tobytes() == seen.tobytes()
        action = np.sin(np.arange(16) + 0.1 * step)
        observation, earned, terminated, _, _ = env.step(action)
        phase = command_step(BODY, action, filtered, phase, 0.01, command, target)
        before, state = state.base_pos[0], backend.step(target.copy())
        mine, down = evaluate_step(
            BODY, state.base_pos, state.base_quat, state.base_lin_vel, state.base_ang_vel, state.measured_joint_pos,
            state.torque_squared_sum, state.fault, before, phase, 0.01, weights, seen,
        )  # fmt: skip
        assert (earned, terminated) == (mine, down)


def test_targets_stay_inside_the_joint_limits():
    target = np.empty(12)
    filtered = np.ones(16)
    filtered[:12] = np.tile([1.0, -1.0, -1.0], 4)
    filtered[14] = -1.0
    low = JOINT_LOWER.copy()
    for phase in np.linspace(0, 0.99, 60):
        command_step(BODY, filtered.copy(), filtered.copy(), phase, 0.01, np.empty(16), target)
        assert np.all(target >= low) and np.all(target <= JOINT_UPPER)


def test_zero_policy_trots_at_1_25_hz():
    env = WalkEnv(PUPPER_V2, GlidingBackend())
    env.reset(seed=0)
    phases = [env.step(np.zeros(16))[4]["phase"] for _ in range(81)]
    assert phases[0] == pytest.approx(0.0125)
    assert min(phases[79], 1.0 - phases[79]) == pytest.approx(0.0, abs=1e-9)  # 0.8 s


def test_reset_forgets_the_episode_before():
    def episode(env):
        first, _ = env.reset(seed=7)
        return [first, *(env.step(np.full(16, 0.7))[0] for _ in range(5))]

    env = WalkEnv(PUPPER_V2, GlidingBackend())
    np.testing.assert_array_equal(episode(env), episode(env))


def test_a_fall_ends_the_episode_without_the_reward_for_staying_up():
    env = WalkEnv(PUPPER_V2, GlidingBackend(fall_at=2))
    env.reset(seed=0)
    _, upright, terminated, _, _ = env.step(np.zeros(16))
    _, falling, down, truncated, _ = env.step(np.zeros(16))
    assert not terminated and down and not truncated
    assert falling == pytest.approx(upright - TaskWeights().alive)
    with pytest.raises(ConfigError, match="reset"):
        env.step(np.zeros(16))


def test_a_fault_ends_the_episode_with_a_finite_observation():
    env = WalkEnv(PUPPER_V2, GlidingBackend(fail_at=2))
    env.reset(seed=0)
    before = env.step(np.zeros(16))[0]
    observation, earned, terminated, _, info = env.step(np.zeros(16))
    assert (earned, terminated, info["fault"]) == (0.0, True, 1)
    np.testing.assert_array_equal(observation, before)
    with pytest.raises(SimulationFault):
        WalkEnv(PUPPER_V2, GlidingBackend(fail_at=0)).reset(seed=0)


def test_time_runs_out_as_truncation():
    env = WalkEnv(PUPPER_V2, GlidingBackend(), episode_steps=3)
    env.reset(seed=0)
    assert [env.step(np.zeros(16))[2:4] for _ in range(3)] == [(False, False)] * 2 + [(False, True)]


def test_unseeded_resets_differ_and_follow_from_the_first_seed():
    backends = GlidingBackend(), GlidingBackend()
    for backend in backends:
        env = WalkEnv(PUPPER_V2, backend)
        env.reset(seed=5)
        env.reset()
        env.reset()
        env.close()
    assert backends[0].seeds == backends[1].seeds and len(set(backends[0].seeds)) == 3
    assert backends[0].seeds[0] == 5 and backends[0].closed


def test_a_wrong_action_is_refused():
    env = WalkEnv(PUPPER_V2, GlidingBackend())
    with pytest.raises(ConfigError, match="reset"):
        env.step(np.zeros(16))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"\(12,\), wanted \(16,\)"):
        env.step(np.zeros(12))
    with pytest.raises(ConfigError, match="not finite"):
        env.step(np.full(16, np.nan))


def test_statistics_of_an_episode_equal_numpy():
    observations = np.random.default_rng(0).normal(3.0, 2.0, (50, 18))
    count, mean, m2 = 0, np.zeros(18), np.zeros(18)
    for observation in observations:
        count = accumulate_moments(observation, count, mean, m2)
    assert count == 50
    np.testing.assert_allclose(mean, observations.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(m2 / 50, observations.var(axis=0), rtol=1e-12)
