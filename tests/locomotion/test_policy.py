"""The linear policy by hand, its filter and scaling, and its file."""

import math
from dataclasses import replace

import numpy as np
import pytest

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.body import action_size, observation_size
from motorprior.locomotion.policy import (
    Policy,
    act,
    action_to_command,
    low_pass,
)
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def a_policy(**changes):
    rng = np.random.default_rng(3)
    policy = Policy(
        weights=rng.standard_normal((16, 19)),
        observation_mean=rng.standard_normal(18),
        observation_std=rng.uniform(0.1, 2.0, 18),
        kp=np.full(12, 8.8),
        kd=np.full(12, 0.84),
        control_dt=0.01,
        robot=PUPPER_V2.name,
        joint_names=PUPPER_V2.joint_names,
        provenance={"seed": 3, "prior": "abc"},
    )
    return replace(policy, **changes)


def command_of(action):
    out = np.full(16, np.nan)
    action_to_command(np.asarray(action, dtype=float), 0.5, out)
    return out


def test_sizes():
    assert (observation_size(12), action_size(12)) == (18, 16)


def test_action_is_the_clipped_affine_map_of_the_normalised_observation():
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((16, 19)) * 0.2
    mean, std, observation = rng.standard_normal(18), rng.uniform(0.5, 2.0, 18), rng.standard_normal(18)
    out = np.full(16, np.nan)
    act(weights, mean, std, observation, out)
    expected = weights @ np.append((observation - mean) / std, 1.0)
    np.testing.assert_allclose(out, np.clip(expected, -1.0, 1.0), atol=1e-14)
    assert np.any(np.abs(expected) < 1.0)


def test_an_outlier_counts_as_ten_standard_deviations():
    weights = np.zeros((16, 19))
    weights[0, 5], weights[1, 5] = 0.01, -0.05
    observation = np.zeros(18)
    observation[5] = 1e6
    out = np.empty(16)
    act(weights, np.zeros(18), np.ones(18), observation, out)
    assert out[:2] == pytest.approx([0.1, -0.5])


def test_low_pass_is_the_sampled_first_order_step_response():
    state = np.zeros(16)
    for _ in range(7):
        low_pass(np.full(16, 0.8), 0.01, state)
    np.testing.assert_allclose(state, 0.8 * (1.0 - math.exp(-2.0 * math.pi * 3.0 * 0.07)), rtol=1e-12)


def test_low_pass_never_leaves_the_range_of_actions():
    state = np.zeros(16)
    for _ in range(1000):
        low_pass(np.full(16, 1e3), 0.01, state)
    assert np.all(state <= 1.0) and state[0] == pytest.approx(1.0)


def test_zero_action_trots_at_the_middle_of_every_range():
    command = command_of(np.zeros(16))
    np.testing.assert_array_equal(command[:12], 0.0)
    assert command[12:] == pytest.approx([1.25, 0.5, 0.25, 1.0])


def test_ends_of_every_range():
    np.testing.assert_allclose(command_of(np.ones(16)), [0.5] * 12 + [2.0, 1.0, 1.0, 5.0])
    np.testing.assert_allclose(command_of(-np.ones(16)), [-0.5] * 12 + [0.5, 0.0, -0.5, 0.2], atol=1e-15)


def test_file_holds_everything(tmp_path):
    path, policy = tmp_path / "policy.safetensors", a_policy()
    policy.save(path)
    loaded = Policy.load(path)
    for name in ("weights", "observation_mean", "observation_std", "kp", "kd"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(policy, name))
    for name in ("control_dt", "robot", "joint_names", "provenance"):
        assert getattr(loaded, name) == getattr(policy, name)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"weights": np.zeros((16, 18))}, r"weights is float64\(16, 18\), wanted float64\(16, 19\)"),
        ({"weights": np.full((16, 19), np.nan)}, r"weights\[0, 0\] is not finite"),
        ({"kp": np.float64(8.8)}, r"kp is float64\(\), wanted float64\(12,\)"),
        ({"observation_std": np.zeros(18)}, "observation_std holds 0, not above 0"),
        ({"robot": 3}, "robot = 3 is not a text"),
        ({"joint_names": ("a",)}, r"weights is float64\(16, 19\), wanted float64\(5, 8\)"),
        ({"joint_names": ()}, "joint_names"),
        ({"control_dt": 0.0}, "control_dt"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused_before_it_is_written(tmp_path, changes, words):
    with pytest.raises(ArtifactError, match=words):
        a_policy(**changes).save(tmp_path / "policy.safetensors")
    assert list(tmp_path.iterdir()) == []


def test_another_robots_policy_is_refused():
    with pytest.raises(ConfigError, match="policy of robot 'dog', wanted 'pupper_v2'"):
        a_policy(robot="dog").require_robot(PUPPER_V2)
    with pytest.raises(ConfigError, match="its joints are"):
        a_policy(joint_names=PUPPER_V2.joint_names[::-1]).require_robot(PUPPER_V2)
    a_policy().require_robot(PUPPER_V2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tensors, header: header.update(schema_version=2), "schema_version = 2 is not 1"),
        (lambda tensors, header: header.update(kind="prior"), "a prior, not a policy"),
        (lambda tensors, header: header.update(colour=1), r"unknown keys \['colour'\]"),
        (lambda tensors, header: header.pop("robot"), r"missing keys \['robot'\]"),
        (lambda tensors, header: header.update(robot=7), "robot = 7 is not a text"),
        (lambda tensors, header: header.update(control_dt="fast"), "control_dt"),
        (lambda tensors, header: header.update(joint_names=None), "joint_names"),
        (lambda tensors, header: tensors.pop("kd"), r"missing keys \['kd'\]"),
        (lambda tensors, header: tensors.update(kd=np.zeros(3)), r"kd is float64\(3,\), wanted float64\(12,\)"),
        (lambda tensors, header: tensors.update(weights=np.zeros((16, 19), np.float32)), "float32"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path, change, words):
    path = tmp_path / "policy.safetensors"
    a_policy().save(path)
    tensors, header = read_tensors(path)
    change(tensors, header)
    write_tensors(path, tensors, header)
    with pytest.raises(ArtifactError, match=words) as caught:
        Policy.load(path)
    assert str(path) in str(caught.value)
