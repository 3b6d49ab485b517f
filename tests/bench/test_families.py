"""A fleet of foreign motors means what its file says, stands on the bench, and every other truth plugs in as well."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.foreign import ForeignMotors
from motorprior.actuator.foreign_step import FOREIGN as KIND
from motorprior.bench.facts import facts_from_json, read_bench
from motorprior.bench.families import FAMILIES, FOREIGN, UNITS, geared
from motorprior.bench.fleet import fleet_of, load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.identification.judging.bench_fidelity import LONGEST_WORK, bench_errors, seconds_of_work
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.motor_choice import drawn_from
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


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('family = "foreign"', 'family = "alien"', "family = 'alien' is not geared or foreign"),
        ('family = "foreign"', "family = 3", "family = 3 is not geared or foreign"),
        ('family = "foreign"', "", "missing keys .'backlash', 'coulomb'"),
        ("[armature]", "[rotor]", "unknown keys .'rotor'.*missing keys .'armature'"),
        ('unit = "kg·m²"', 'unit = "g·m²"', "unit = 'g·m²' is not 'kg·m²'"),
        ("center = 0.003", "center = 0.0", "center = 0 is not a finite number above 0"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path, old, new, problem):
    assert old in LEAST
    with pytest.raises(ArtifactError) as error:
        load_fleet(written(tmp_path, LEAST.replace(old, new)))
    assert re.search(problem, error.value.problem) and error.value.remedy and "mine.toml" in str(error.value.where)


def table(name: str, body: str) -> str:
    return f'[{name}]\nunit = "{UNITS[name]}"\n{body}\nsource = "test"\n'


def constant(name: str, value: float) -> str:
    return table(name, f'distribution = "constant"\ncenter = {value}')


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"coulomb": 0.05}, "[bristle_stiffness]"),
        ({"load_friction": 0.2}, "[bristle_stiffness]"),
        ({"static_torque": 0.02, "bristle_stiffness": 50.0}, "[stribeck_velocity]"),
        ({"asymmetry": 0.1, "bristle_stiffness": 50.0}, "[coulomb] or [static_torque]"),
        ({"ki": 4.0}, "[integral_limit]"),
        ({"ripple": 0.03}, "[ripple_order]"),
        ({"heat_loss": 0.1}, "[heat_time] or [warmth]"),
        ({"slider_stiffness": 20.0}, "[slider_torque]"),
        ({"sag": 0.1}, "[stall_torque]"),
    ],
)
def test_a_constant_that_does_nothing_without_another_is_refused(tmp_path, given, wanted):
    text = LEAST + "".join(constant(name, value) for name, value in given.items())
    with pytest.raises(ArtifactError) as error:
        load_fleet(written(tmp_path, text))
    assert f"does nothing without {wanted}" in error.value.problem and wanted in error.value.remedy
    first = re.findall(r"\[(\w+)\]", wanted)[0]
    with_it = load_fleet(written(tmp_path, text + constant(first, 0.5)))
    assert set(given) < set(with_it.parameters)


def test_a_constant_of_zero_needs_no_other(tmp_path):
    assert load_fleet(written(tmp_path, LEAST + constant("coulomb", 0.0))).parameters["coulomb"].center == 0.0


NORMAL = 'distribution = "normal"\ncenter = {}\nspread = {}\ncenter_uncertainty = 0.0'


@pytest.mark.parametrize(
    ("name", "body", "least", "most"),
    [
        ("coulomb", NORMAL.format(0.05, 0.1), 0.0, 1.0),
        ("delay", NORMAL.format(0.01, 2.0).replace("normal", "lognormal"), 0.0, 1.0),
        ("heat_loss", NORMAL.format(0.5, 0.4), 0.0, 1.0),
        ("asymmetry", NORMAL.format(0.0, 0.6), -1.0, 1.0),
    ],
)
def test_draws_beyond_the_bounds_of_a_constant_are_put_there(tmp_path, name, body, least, most):
    others = {"bristle_stiffness": 50.0, "heat_time": 100.0, "coulomb": 0.1}
    text = LEAST + table(name, body) + "".join(constant(each, others[each]) for each in others if each != name)
    fleet = load_fleet(written(tmp_path, text))
    drawn = getattr(fleet.sample(4000, 0), name)
    assert drawn.min() >= least and drawn.max() <= most
    assert np.isclose(drawn, most).any() or name == "coulomb"
    assert np.isclose(drawn, least, atol=1e-12).any() or name == "delay"


@pytest.mark.parametrize(
    "body", ['distribution = "uniform"\nlow = 0.0\nhigh = 1.0', 'distribution = "constant"\ncenter = 0.4']
)
def test_a_switch_is_on_or_off(tmp_path, body):
    with pytest.raises(ArtifactError, match="it is a switch -> give a constant of 0 or 1"):
        load_fleet(written(tmp_path, LEAST + table("output_encoder", body)))


def test_motors_of_a_bench_that_was_recorded_earlier_are_drawn_again(tmp_path):
    """A summary without what a file must have today."""
    fleet = load_fleet(written(tmp_path, LEAST))
    parameters = fleet.summary() | {"coulomb": {"kind": "constant", "center": 0.05}}
    again = fleet_of("mine", "test", "pupper_v2", parameters, "bench.json", FOREIGN)
    motors = again.sample(3, 0)
    assert isinstance(motors, ForeignMotors)
    np.testing.assert_array_equal(motors.coulomb, 0.05)


def test_families_have_the_fields_of_their_motors_and_agree_on_units():
    for family in FAMILIES.values():
        fields = set(family.motors({name: np.ones(2) for name in family.units}).__dataclass_fields__)
        assert fields == set(family.units) - {"kd_over_kp"} | {"kd"}
        assert all(UNITS[name] == unit for name, unit in family.units.items())
        assert set(family.largest) | family.positive | family.signed | family.optional <= set(family.units)


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


def test_the_warmth_of_held_out_trials_is_not_known():
    work = np.concatenate([seconds_of_work(kind, 0) for kind in ("gait", "impacts", "chirp")])
    assert len(set(work)) == 12 and work.min() >= 0 and work.max() <= LONGEST_WORK
    motors = sampled("foreign_direct", 4)
    cold = replace(motors, heat_loss=np.zeros(4))
    same = {"itself": lambda index: cold.take(index).actuator()}
    assert all(np.all(found["itself"] == 0.0) for found in bench_errors(cold, same, 0).values())
    warm = {"itself": lambda index: motors.take(index).actuator()}
    assert all(np.all(found["itself"] > 0.0) for found in bench_errors(motors, warm, 0).values())


def test_robots_walk_on_motors_of_any_family():
    for name in (*NAMES, "mixed"):
        fleet = load_fleet(name)
        draw, physics_dt = drawn_from(fleet, PUPPER_V2)
        assert physics_dt == 0.001 and draw(np.random.default_rng(0)).kind is fleet.kind
        assert draw_twin_motors(PUPPER_V2, fleet, np.random.default_rng(0)).kind is fleet.kind


def test_only_geared_motors_stand_behind_a_wire():
    assert len(geared(load_fleet("mixed").sample(2, 0))) == 2
    with pytest.raises(ConfigError, match="the fleet's motors are foreign, not geared") as error:
        geared(load_fleet("foreign_servo").sample(2, 0))
    assert error.value.remedy and error.value.argument == "fleet"
