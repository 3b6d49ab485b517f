"""A fleet of out-of-family motors has the constants in its file, and a bench reproduces its motors."""

import json
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.bench.bench_folder import bench_from_json, read_bench
from motorprior.bench.families import OUT_OF_FAMILY
from motorprior.bench.fleet import load_fleet
from motorprior.commands.bench import Bench, run_bench

LEAST = """
name = "mine"
family = "foreign"
motor = "test"
robot = "pupper_v2"
""" + "".join(
    f'[{name}]\nunit = "{OUT_OF_FAMILY.units[name]}"\ndistribution = "constant"\ncenter = {value}\nsource = "test"\n'
    for name, value in zip(
        sorted(OUT_OF_FAMILY.units.keys() - OUT_OF_FAMILY.optional), (0.003, 60.0, 0.05, 9.0, 2.0), strict=True
    )
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_a_file_leaves_out_is_off(tmp_path):
    fleet = load_fleet(written(tmp_path, LEAST))
    assert fleet.kind is OUT_OF_FAMILY.kind and sorted(fleet.summary()) == sorted(
        set(OUT_OF_FAMILY.units) - OUT_OF_FAMILY.optional
    )
    motors = fleet.sample(3, 0)
    assert isinstance(motors, OutOfFamilyMotors)
    np.testing.assert_allclose(motors.kd, 0.45)
    assert not any(getattr(motors, name).any() for name in OUT_OF_FAMILY.optional)


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
