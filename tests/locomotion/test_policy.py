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
    mean = rng.standard_normal(OBSERVATIONS)
    std = rng.uniform(0.1, 2.0, OBSERVATIONS)
    arrays = random_policy(1.0, seed=3, units=units)._replace(mean=mean, std=std)
    return as_file_content(arrays, provenance={"seed": 3, "prior": "abc"}, **changes)


@pytest.mark.parametrize("units", [0, 1, 6])
def test_an_action_is_the_clipped_map_of_the_normalised_observation(units):
    rng = np.random.default_rng(0)
    mean = rng.standard_normal(OBSERVATIONS)
    std = rng.uniform(0.5, 2.0, OBSERVATIONS)
    policy = random_policy(0.2, seed=1, units=units)._replace(mean=mean, std=std)
    observation = rng.standard_normal(OBSERVATIONS)

    action = np.full(ACTIONS, np.nan)
    act(policy, observation, action)

    inputs = np.append((observation - mean) / std, 1.0)
    unclipped = policy.weights @ inputs + policy.readout.T @ np.tanh(policy.hidden @ inputs)
    np.testing.assert_allclose(action, np.clip(unclipped, -1.0, 1.0), atol=1e-13)
    assert np.any(np.abs(unclipped) < 1.0)
    assert np.any(np.abs(unclipped) > 1.0)


def test_the_low_pass_is_the_sampled_first_order_step_response():
    state = np.zeros(ACTIONS)
    for _ in range(7):
        low_pass(np.full(ACTIONS, 0.8), 0.01, state)

    # cut-off at 3 Hz, after 7 steps of 10 ms
    response = 0.8 * (1.0 - math.exp(-2.0 * math.pi * 3.0 * 0.07))
    np.testing.assert_allclose(state, response, rtol=1e-12)


@pytest.mark.parametrize("units", [0, 3])
def test_a_saved_policy_is_loaded_with_all_its_fields(tmp_path, units):
    path = tmp_path / "policy.safetensors"
    policy = a_policy(units, forward=(-0.1, 0.9))

    policy.save(path)
    loaded = Policy.load(path)

    for name, array in policy.arrays._asdict().items():
        np.testing.assert_array_equal(getattr(loaded.arrays, name), array, strict=True)
    for name in ("kp", "kd"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(policy, name), strict=True)
    for name in ("control_dt", "robot", "joint_names", "forward", "provenance"):
        assert getattr(loaded, name) == getattr(policy, name)


TURNED_NAMES = PUPPER_V2.joint_names[::-1]


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("robot", "dog", ["dog", PUPPER_V2.name]),
        ("joint_names", TURNED_NAMES, [str(list(TURNED_NAMES)), str(list(PUPPER_V2.joint_names))]),
        ("control_dt", 0.02, ["0.02", str(PUPPER_V2.control_dt)]),
    ],
)
def test_another_robots_policy_is_refused_with_both_values(field: str, value: Any, named: list):
    a_policy().require_robot(PUPPER_V2)

    with pytest.raises(ConfigError) as refused:
        replace(a_policy(), **{field: value}).require_robot(PUPPER_V2)

    for value_in_message in named:
        assert value_in_message in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [("schema_version", 3), ("fastest", -1.0)],
)
def test_a_header_that_does_not_fit_is_refused_with_its_key_and_value(tmp_path, key, value):
    with pytest.raises(ArtifactError, match=f"{key} = {value:g}") as refused:
        load_changed(tmp_path, header_changes={key: value})

    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize(
    ("name", "tensor", "values"),
    [
        ("hidden", None, []),
        ("kd", np.zeros(3), ["float64(3,)", "float64(12,)"]),
        ("weights", np.zeros((17, 24), np.float32), ["float32"]),
    ],
)
def test_a_tensor_that_does_not_fit_is_refused_with_its_name(tmp_path, name, tensor, values):
    with pytest.raises(ArtifactError, match=name) as refused:
        load_changed(tmp_path, tensor_changes={name: tensor})

    for value in (*values, str(tmp_path)):
        assert value in str(refused.value)


def load_changed(folder, tensor_changes=None, header_changes=None):
    """Load a policy whose file has other tensors or header values; None removes a tensor."""
    path = folder / "policy.safetensors"
    a_policy().save(path)
    tensors, header = read_tensors(path)
    header.update(header_changes or {})
    for name, tensor in (tensor_changes or {}).items():
        del tensors[name]
        if tensor is not None:
            tensors[name] = tensor
    write_tensors(path, tensors, header)

    return Policy.load(path)
