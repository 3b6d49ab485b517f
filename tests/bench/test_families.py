"""A bench reproduces the motors of its fleet, of any family."""

import json

import numpy as np
import pytest

from motorprior.bench.bench_folder import bench_from_json, read_bench
from motorprior.bench.fleet import load_fleet
from motorprior.commands.bench import Bench, run_bench


@pytest.mark.parametrize("name", ["foreign_direct", "mixed"])
def test_a_bench_gives_its_motors_back(tmp_path, name):
    run_bench(Bench(tmp_path, name, "rollout", 3, 1200, 5))
    log, bench = read_bench(tmp_path)
    fleet = load_fleet(name)
    assert bench.fleet == fleet and (log.num_joints, log.num_rows) == (3, 1200) and log.motor == fleet.motor
    drawn, again = (found.physical_motors() for found in (bench, bench_from_json(bench.as_json(), "here")))
    np.testing.assert_array_equal(drawn.kp, again.kp)
    text = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert text.get("family", "geared") == fleet.family and ("family" in text) == (name != "mixed")
