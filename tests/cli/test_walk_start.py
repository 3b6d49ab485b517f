"""`motorprior walk --start POLICY` goes on from a policy, and never ends with a worse one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig
from motorprior.search.policy_search import new_search

Command = Callable[..., Any]
SMALL = ("walk", "--actuator", "pd", "--episode-steps", 20)


def policy_in(folder: Path) -> Policy:
    return Policy.load(folder / "policy.safetensors")


def test_a_search_begins_with_the_policy_and_its_view_of_the_world():
    rng = np.random.default_rng(0)
    policy = Policy(
        rng.standard_normal((16, 19)),
        rng.standard_normal(18),
        rng.uniform(0.1, 2.0, 18),
        np.ones(12),
        np.ones(12),
        0.01,
        PUPPER_V2.name,
        PUPPER_V2.joint_names,
    )
    search = new_search(ArsConfig(), PUPPER_V2.num_joints, policy)
    np.testing.assert_array_equal(search.parameters.reshape(16, 19), policy.weights)
    np.testing.assert_allclose(search.observations.mean, policy.observation_mean)
    np.testing.assert_allclose(search.observations.std(), policy.observation_std)


def test_a_start_that_nothing_improves_on_is_kept(motorprior: Command, tmp_path: Path):
    assert motorprior(*SMALL, "--iterations", 3, "--out", tmp_path / "first").code == 0
    start = tmp_path / "first" / "policy.safetensors"
    wild = ("--search.step-size", 100.0, "--iterations", 1, "--start", start)
    assert motorprior(*SMALL, *wild, "--out", tmp_path / "second").code == 0
    first, second = policy_in(tmp_path / "first"), policy_in(tmp_path / "second")
    np.testing.assert_array_equal(second.weights, first.weights)
    assert second.provenance["start_sha256"] and first.provenance["start_sha256"] is None
    gentle = ("--search.step-size", 0.02, "--iterations", 6, "--start", start)
    assert motorprior(*SMALL, *gentle, "--out", tmp_path / "third").code == 0
    assert policy_in(tmp_path / "third").provenance["own_return"] >= second.provenance["own_return"]


def test_a_start_that_is_no_policy_is_refused(motorprior: Command, tmp_path: Path):
    (tmp_path / "text.safetensors").write_text("no policy")
    for name in ("text.safetensors", "missing.safetensors"):
        found = motorprior(*SMALL, "--start", tmp_path / name, "--out", tmp_path / "out")
        assert found.code == 2 and name in found.err
