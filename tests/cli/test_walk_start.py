"""`motorprior walk --start POLICY` continues from a policy and never returns a worse one; `--seeds` trains several."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.locomotion.policy import Policy

Command = Callable[..., Any]
SMALL = ("walk", "--motors", "pd", "--episode-steps", 20)


def policy_in(folder: Path) -> Policy:
    return Policy.load(folder / "policy.safetensors")


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


def test_a_start_of_another_gait_or_size_is_rejected(motorprior: Command, tmp_path: Path):
    assert motorprior(*SMALL, "--iterations", 1, "--gait", "pace", "--out", tmp_path / "pace").code == 0
    start = tmp_path / "pace" / "policy.safetensors"
    assert policy_in(tmp_path / "pace").gait == "pace"
    for words in ((), ("--gait", "pace", "--hidden-units", 4)):
        assert motorprior(*SMALL, *words, "--iterations", 1, "--start", start, "--out", tmp_path / "out").code == 2
