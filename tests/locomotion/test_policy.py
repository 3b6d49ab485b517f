"""The policy by hand, its filter and scaling, and its file."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from policies import ACTIONS, OBSERVATIONS, as_file_content, random_policy

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.gait import walker_arrays
from motorprior.locomotion.policy import Policy, act, low_pass
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WALKER = walker_arrays(PUPPER_V2)


def a_policy(units=3, **changes: Any):
    rng = np.random.default_rng(3)
    arrays = random_policy(1.0, seed=3, units=units)
    arrays = arrays._replace(
        mean=rng.standard_normal(OBSERVATIONS), std=rng.uniform(0.1, 2.0, OBSERVATIONS)
    )
    return as_file_content(arrays, provenance={"seed": 3, "prior": "abc"}, **changes)


def acted(policy, observation):
    out = np.full(ACTIONS, np.nan)
    act(policy, observation, out)
    return out


@pytest.mark.parametrize("units", [0, 1, 6])
def test_action_is_the_clipped_map_of_the_normalised_observation(units):
    rng = np.random.default_rng(0)
    policy = random_policy(0.2, seed=1, units=units)
    policy = policy._replace(
        mean=rng.standard_normal(OBSERVATIONS), std=rng.uniform(0.5, 2.0, OBSERVATIONS)
    )
    observation = rng.standard_normal(OBSERVATIONS)
    inputs = np.append((observation - policy.mean) / policy.std, 1.0)
    expected = policy.weights @ inputs + policy.readout.T @ np.tanh(policy.hidden @ inputs)
    np.testing.assert_allclose(acted(policy, observation), np.clip(expected, -1.0, 1.0), atol=1e-13)
    assert np.any(np.abs(expected) < 1.0) and np.any(np.abs(expected) > 1.0)


def test_low_pass_is_the_sampled_first_order_step_response():
    state = np.zeros(ACTIONS)
    for _ in range(7):
        low_pass(np.full(ACTIONS, 0.8), 0.01, state)
    np.testing.assert_allclose(
        state, 0.8 * (1.0 - math.exp(-2.0 * math.pi * 3.0 * 0.07)), rtol=1e-12
    )


@pytest.mark.parametrize("units", [0, 3])
def test_file_holds_everything(tmp_path, units):
    path = tmp_path / "policy.safetensors"
    policy = a_policy(units, forward=(-0.1, 0.9))
    policy.save(path)
    loaded = Policy.load(path)
    for one, other in zip(
        (*loaded.arrays, loaded.kp, loaded.kd), (*policy.arrays, policy.kp, policy.kd), strict=True
    ):
        np.testing.assert_array_equal(one, other, strict=True)
    for name in ("control_dt", "robot", "joint_names", "forward", "provenance"):
        assert getattr(loaded, name) == getattr(policy, name)


def test_another_robots_policy_is_refused():
    for name, value, words in (
        ("robot", "dog", "robot of the policy: 'dog', wanted 'pupper_v2'"),
        ("joint_names", PUPPER_V2.joint_names[::-1], "joints of the policy"),
        ("control_dt", 0.02, "control period .* 0.02, wanted 0.01"),
    ):
        with pytest.raises(ConfigError, match=words):
            replace(a_policy(), **{name: value}).require_robot(PUPPER_V2)
    a_policy().require_robot(PUPPER_V2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tensors, header: header.update(schema_version=3), "schema_version = 3 is not 4"),
        (lambda tensors, header: header.update(fastest=-1.0), "fastest = -1 is not"),
        (lambda tensors, header: tensors.pop("hidden"), r"missing keys \['hidden'\]"),
        (
            lambda tensors, header: tensors.update(kd=np.zeros(3)),
            r"kd is float64\(3,\), wanted float64\(12,\)",
        ),
        (lambda tensors, header: tensors.update(weights=np.zeros((17, 24), np.float32)), "float32"),
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
