"""`train_policy` is `walk` without files: the same options, the same policies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motorprior as mp
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2

SHORT: dict[str, Any] = {"iterations": 1, "episode_steps": 10, "workers": 1}


@pytest.mark.parametrize(
    "options", [{"symmetric": False}, {"hidden_units": 2}, {"hidden_units": 3, "symmetric": False}]
)
def test_symmetry_and_hidden_units_are_those_of_walk(options: dict[str, Any], tmp_path: Path):
    run_walk(Walk(tmp_path, "fleet", **SHORT, **options))
    walked = Policy.load(tmp_path / POLICY)
    found = mp.train_policy(PUPPER_V2, mp.load_fleet("pupper_v2"), **SHORT, **options)
    assert len(found.hidden) == options.get("hidden_units", 0) and found.weights.any(), "or nothing would differ"
    assert found.provenance["symmetric"] == walked.provenance["symmetric"] == options.get("symmetric", True)
    for name in ("weights", "hidden", "readout"):
        np.testing.assert_array_equal(getattr(found, name), getattr(walked, name))
    assert found.provenance["own_return"] == walked.provenance["own_return"]


@pytest.mark.parametrize("given", ["mixed", mp.load_fleet("mixed")], ids=["by name", "as it is"])
def test_policies_are_evaluated_on_the_validation_fleet(given: Any, tmp_path: Path):
    run_walk(Walk(tmp_path, "fleet", validation="mixed", **SHORT))
    fleet = mp.load_fleet("pupper_v2")
    validated, trained = (mp.train_policy(PUPPER_V2, fleet, validation=each, **SHORT) for each in (given, None))
    walked = Policy.load(tmp_path / POLICY).provenance["own_return"]
    assert validated.provenance["own_return"] == walked != trained.provenance["own_return"]
    assert (validated.provenance["validation"], trained.provenance["validation"]) == ("mixed", None)
