"""A fleet of foreign motors means what its file says, stands on the bench, and every other truth plugs in as well."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.foreign import ForeignMotors
from motorprior.actuator.foreign_step import FOREIGN as KIND
from motorprior.bench.facts import facts_from_json, read_bench
from motorprior.bench.families import FOREIGN, UNITS
from motorprior.bench.fleet import fleet_of, load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.motor_choice import motor_sampler
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.transfer.twin import draw_twin_motors

NAMES = ["foreign_direct", "foreign_servo"]
LEAST = """
name = "mine"
family = "foreign"
motor = "test"
robot = "pupper_v2"
""" + "".join(
    f'[{name}]\nunit = "{UNITS[name]}"\ndistribution = "constant"\ncenter = {value}\nsource = "test"\n'
    for name, value in zip(sorted(FOREIGN.units.keys() - FOREIGN.optional), (0.003, 60.0, 0.05, 9.0, 2.0), strict=True)
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def sampled(name: str, count: int) -> ForeignMotors:
    motors = load_fleet(name).sample(count, 1)
    assert isinstance(motors, ForeignMotors)
    return motors


def test_what_a_file_leaves_out_is_off(tmp_path):
    fleet = load_fleet(written(tmp_path, LEAST))
    assert fleet.kind is KIND and sorted(fleet.summary()) == sorted(set(FOREIGN.units) - FOREIGN.optional)
    motors = fleet.sample(3, 0)
    assert isinstance(motors, ForeignMotors)
    np.testing.assert_allclose(motors.kd, 0.45)
    assert not any(getattr(motors, name).any() for name in FOREIGN.optional)


def table(name: str, body: str) -> str:
    return f'[{name}]\nunit = "{UNITS[name]}"\n{body}\nsource = "test"\n'


def constant(name: str, value: float) -> str:
    return table(name, f'distribution = "constant"\ncenter = {value}')


def test_motors_of_a_bench_that_was_recorded_earlier_are_drawn_again(tmp_path):
    """A summary without what a file must have today."""
    fleet = load_fleet(written(tmp_path, LEAST))
    parameters = fleet.summary() | {"coulomb": {"kind": "constant", "center": 0.05}}
    again = fleet_of("mine", "test", "pupper_v2", parameters, "bench.json", FOREIGN)
    motors = again.sample(3, 0)
    assert isinstance(motors, ForeignMotors)
    np.testing.assert_array_equal(motors.coulomb, 0.05)


@pytest.mark.parametrize("name", NAMES)
def test_every_sampled_motor_can_exist(name):
    motors = sampled(name, 5000)
    assert np.isfinite(motors.table()).all() and len(motors) == 5000
    for field in FOREIGN.units.keys() - FOREIGN.signed - {"kd_over_kp"}:
        assert np.min(getattr(motors, field)) >= 0.0, field
    for field in FOREIGN.positive:
        assert np.min(getattr(motors, field)) > 0.0, field
    assert np.all(motors.load_friction < 1.0)  # or the gear locks itself for good


@pytest.mark.parametrize("name", [*NAMES, "mixed"])
def test_a_bench_gives_its_motors_back(tmp_path, name):
    run_bench(Bench(tmp_path, name, "rollout", 3, 1200, 5))
    log, facts = read_bench(tmp_path)
    fleet = load_fleet(name)
    assert facts.fleet == fleet and (log.num_joints, log.num_rows) == (3, 1200) and log.motor == fleet.motor
    drawn, again = (found.physical_motors() for found in (facts, facts_from_json(facts.as_json(), "here")))
    np.testing.assert_array_equal(drawn.kp, again.kp)
    text = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert text.get("family", "geared") == fleet.family and ("family" in text) == (name != "mixed")
    with pytest.raises(ArtifactError, match="family = 'alien' is not geared or foreign"):
        facts_from_json({**text, "family": "alien"}, "here")


def test_a_log_is_of_motors_that_warm_up_and_of_noisy_instruments():
    motors, fleet = sampled("foreign_direct", 2), load_fleet("foreign_direct")
    preset = replace(PRESETS["rollout"], segment_steps=200, kinds=("sine",))
    noisy, again = (record(motors, preset, 400, 0, fleet).joint_pos for _ in range(2))
    clean = record(replace(motors, log_position_noise=np.zeros(2)), preset, 400, 0, fleet).joint_pos
    assert noisy.tobytes() == again.tobytes() and np.std(noisy - clean) == pytest.approx(2e-4, rel=0.1)
    loss = np.full(2, 0.3)  # warm at once, so that all but the first segment starts warm
    fast = replace(motors, heat_loss=loss, heat_time=np.full(2, 1e-9), warmth=np.zeros(2))
    warm = replace(motors, heat_loss=loss, heat_time=np.zeros(2), warmth=np.ones(2))
    one, other = (record(each, preset, 400, 0, fleet).joint_pos for each in (fast, warm))
    np.testing.assert_array_equal(one[200:], other[200:])
    assert np.any(other[200:] != noisy[200:])


def test_robots_walk_on_motors_of_any_family():
    for name in (*NAMES, "mixed"):
        fleet = load_fleet(name)
        draw, physics_dt = motor_sampler(fleet, PUPPER_V2)
        assert physics_dt == 0.001 and draw(np.random.default_rng(0)).kind is fleet.kind
        assert draw_twin_motors(PUPPER_V2, fleet, np.random.default_rng(0)).kind is fleet.kind
