"""A mirror swaps left and right, twice is nothing, and a symmetric policy cannot limp."""

import numpy as np
import pytest
from policies import ACTIONS, OBSERVATIONS, stats_of

from motorprior.backend import BackendState
from motorprior.locomotion.body import GAITS, GaitName, body_of
from motorprior.locomotion.control_step import command_step, follow_command, new_gait
from motorprior.locomotion.policy import act
from motorprior.locomotion.policy_shape import PolicyShape, mirror_of
from motorprior.locomotion.task import observe
from motorprior.robots.pupper_v2.robot import PUPPER_V2

RIGHT_TO_LEFT = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
ABDUCTIONS = np.tile([-1.0, 1.0, 1.0], 4)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize("gait", GAITS)
def test_a_mirror_image_of_a_mirror_image_is_the_original(gait: GaitName, rng):
    mirror = mirror_of(PUPPER_V2, gait)
    for swap, size in (
        (mirror.observation, OBSERVATIONS), (mirror.action, ACTIONS), (mirror.inputs, OBSERVATIONS + 1)
    ):  # fmt: skip
        vectors = rng.standard_normal((7, size))
        assert not np.array_equal(swap.mirrored(vectors), vectors)
        np.testing.assert_array_equal(swap.mirrored(swap.mirrored(vectors)), vectors)
        matrix = rng.standard_normal((3, size))
        np.testing.assert_allclose(swap.columns(matrix) @ vectors[0], matrix @ swap.mirrored(vectors[0]), atol=1e-13)


def test_the_joints_of_a_mirrored_robot_are_its_partners_with_abduction_turned(rng):
    joints = rng.standard_normal(12)
    seen = np.concatenate([np.zeros(5), joints, np.zeros(6)])
    mirrored = mirror_of(PUPPER_V2).observation.mirrored(seen)
    np.testing.assert_array_equal(mirrored[5:17], ABDUCTIONS * joints[RIGHT_TO_LEFT])
    action = np.concatenate([joints, [0.1, 0.2, 0.3, 0.4, 0.5]])
    expected = [*(ABDUCTIONS * joints[RIGHT_TO_LEFT]), 0.1, 0.2, 0.3, 0.4, -0.5]
    np.testing.assert_array_equal(mirror_of(PUPPER_V2).action.mirrored(action), expected)


@pytest.mark.parametrize(("forward", "yaw_rate"), [(0.3, 0.4), (-0.2, 0.4), (0.0, 0.6), (-0.03, 0.6)])
@pytest.mark.parametrize("gait", GAITS)
def test_a_mirrored_robot_observes_the_mirrored_observation(gait: GaitName, forward: float, yaw_rate: float, rng):
    """Both gaits run from the same phase, the mirrored one half a cycle later where the legs of a pair alternate."""
    mirror, body = mirror_of(PUPPER_V2, gait), body_of(PUPPER_V2, gait)._replace(levelling_gain=0.2)
    one, other = new_gait(body), new_gait(body)
    other.scalars[0] = 0.0 if gait in ("bound", "pronk") else 0.5

    def seen(state, quat, rates, joints, yaw_rate):
        nothing = np.zeros(3)
        at = BackendState(nothing, quat, nothing, rates, joints + PUPPER_V2.nominal_pose, np.zeros((4, 3)), 0.0)
        observe(body, at, state.observation)
        follow_command(body, state, forward, yaw_rate)
        return state.observation

    for _ in range(60):
        w, x, y, z = np.array([1.0, 0.0, 0.0, 0.0]) + rng.uniform(0.1, 0.2, 4)
        rates, joints, length = rng.standard_normal(3), rng.standard_normal(12), np.sqrt(w * w + x * x + y * y + z * z)
        straight = seen(one, np.array([w, x, y, z]) / length, rates, joints, yaw_rate)
        turned = rates * [-1.0, 1.0, -1.0], ABDUCTIONS * joints[RIGHT_TO_LEFT]
        reflected = seen(other, np.array([w, -x, y, -z]) / length, *turned, -yaw_rate)
        np.testing.assert_allclose(mirror.observation.mirrored(straight), reflected, atol=1e-12)
        action = rng.uniform(-1.0, 1.0, ACTIONS)
        command_step(body, one, action)
        command_step(body, other, mirror.action.mirrored(action))
        np.testing.assert_allclose(ABDUCTIONS * one.target[RIGHT_TO_LEFT], other.target, atol=1e-12)


@pytest.mark.parametrize("gait", GAITS)
@pytest.mark.parametrize("units", [0, 5])
def test_a_symmetric_policy_answers_the_mirrored_observation_with_the_mirrored_action(gait: GaitName, units, rng):
    shape = PolicyShape.of(PUPPER_V2, gait, 2 * units, symmetric=True)
    seen = stats_of(rng.normal(0.3, 1.0, (40, OBSERVATIONS)))
    policy, mirror = shape.policy(0.15 * rng.standard_normal(shape.size), seen), mirror_of(PUPPER_V2, gait)
    assert len(policy.hidden) == 2 * units
    one, other, clipped = np.zeros(ACTIONS), np.zeros(ACTIONS), 0
    for observation in rng.normal(0.0, 1.0, (50, OBSERVATIONS)):
        act(policy, observation, one)
        act(policy, mirror.observation.mirrored(observation), other)
        np.testing.assert_allclose(other, mirror.action.mirrored(one), atol=1e-12)
        clipped += int(np.all(np.abs(one) == 1.0))
    assert clipped == 0, "a policy at its limits answers nothing"


def test_symmetric_weights_are_the_nearest_and_stay_what_they_are(rng):
    mirror, weights = mirror_of(PUPPER_V2), rng.standard_normal((ACTIONS, OBSERVATIONS + 1))
    nearest = mirror.symmetric(weights)
    np.testing.assert_allclose(mirror.symmetric(nearest), nearest, atol=1e-15)
    for _ in range(5):
        other = mirror.symmetric(rng.standard_normal(weights.shape))
        assert abs(np.sum((weights - nearest) * other)) < 1e-10, "what was cut is at right angles to what is symmetric"
