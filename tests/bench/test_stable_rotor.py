"""Motors whose rotor cannot be simulated on its gear are refused by name and bound, before anything is simulated."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.torque_law import reset_actuator, step_actuator
from motorprior.bench.distribution import Distribution
from motorprior.bench.families import FAMILIES, Family
from motorprior.bench.fleet import Fleet, fleet_path, load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.shipped import SHIPPED

FURTHER = {"slider_stiffness", "bristle_stiffness", "bristle_damping", "gear_hardening"}
"""What else is a spring or damps a rotor."""
SHIPPED_FLEETS = [name for robot in SHIPPED for name, _ in robot.fleets]


def center(name: str, **changes: float) -> tuple[Family, dict[str, np.ndarray]]:
    """The constants of a fleet's central motor, some of them changed."""
    fleet = load_fleet(name)
    values = {parameter: d.center for parameter, d in fleet.parameters.items()} | changes
    return FAMILIES[fleet.family], {parameter: np.array([value]) for parameter, value in values.items()}


def is_stable(family: Family, values: dict[str, np.ndarray]) -> bool:
    try:
        family.require_stable(values, "here")
    except ConfigError:
        return False
    return True


def with_constant(name: str, parameter: str, value: float, path: Path) -> Path:
    """The file of a fleet whose ``parameter`` is the same for every motor."""
    text = fleet_path(name).read_text("utf-8")
    head, _, after = text.partition(f"[{parameter}]\n")
    unit = next(line for line in after.splitlines() if line.startswith("unit"))
    table = f'[{parameter}]\n{unit}\ndistribution = "constant"\ncenter = {value}\nsource = "test"\n\n'
    rest = after[after.find("\n[") + 1 :] if "\n[" in after else ""
    path.write_text(head + table + rest, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", SHIPPED_FLEETS)
def test_shipped_fleets_are_far_from_the_bound(name: str):
    motors = load_fleet(name).sample(2000, 3)
    family = FAMILIES[load_fleet(name).family]
    fields = ("torque_limit", *family.stiffness, *family.damping, *({"gear_hardening"} & family.optional))
    values = {field: getattr(motors, field) for field in fields}
    family.require_stable(values | {"armature": np.asarray(motors.armature) / 4.0}, "a quarter")


@pytest.mark.parametrize("name", ["pupper_v2", "foreign_direct"])
@pytest.mark.parametrize(("stiffness", "damping"), [(80.0, 0.03), (2000.0, 0.0), (1.0, 2.0), (500.0, 0.4)])
def test_the_bound_is_that_of_the_roots(name: str, stiffness: float, damping: float):
    family, values = center(name, gear_stiffness=stiffness, gear_damping=damping, viscous_damping=0.0)
    values |= {each: np.zeros(1) for each in FURTHER & values.keys()}
    h, found = family.substep, []
    for armature in np.geomspace(1e-8, 1e-2, 400):
        a, b = damping * h / armature, stiffness * h * h / armature
        largest = np.abs(np.linalg.eigvals(np.array([[1.0 - a, -b], [1.0 - a, 1.0 - b]]))).max()
        found.append(is_stable(family, values | {"armature": np.array([armature])}) == (largest <= 1.0 + 1e-9))
    assert all(found)


@pytest.mark.parametrize("name", ["pupper_v2", "foreign_direct"])
@pytest.mark.parametrize(("share", "bounded"), [(0.98, False), (1.02, True)])
def test_a_rotor_alone_on_its_spring_keeps_to_the_bound(name: str, share: float, bounded: bool):
    family, values = center(name)
    off = {parameter: np.zeros(1) for parameter in values.keys() - {"gear_stiffness", "stribeck_velocity"}}
    h = family.substep
    on = {
        "armature": share * values["gear_stiffness"] * h**2 / 4.0,
        "kp": np.full(1, 1e-9),
        "kd_over_kp": np.full(1, 1e-9),
    }
    on |= {"torque_limit": np.full(1, 1e-12), "stall_torque": np.ones(1), "no_load_speed": np.full(1, 1e9)}
    alone = values | off | on | {"velocity_filter": np.ones(1)}
    assert is_stable(family, alone) is bounded
    arrays = family.motors(alone).actuator().arrays(h)
    zero, torque, largest = np.zeros(1), np.zeros(1), 0.0
    reset_actuator(arrays, zero, np.full(1, 1e-6))  # the rotor starts a little above a joint that is held at zero
    for _ in range(2000):
        step_actuator(arrays, h, zero, zero, zero, torque)
        largest = max(largest, abs(float(torque[0])) / float(values["gear_stiffness"][0]))
    assert (largest < 1e-4) is bounded


@pytest.mark.parametrize(
    ("parameter", "value"),
    [("armature", 1e-12), ("gear_stiffness", 1e9), ("gear_damping", 1e6), ("viscous_damping", 1e6)],
)
def test_a_fleet_beyond_it_is_refused_by_name_and_each_remedy_helps(tmp_path: Path, parameter: str, value: float):
    path = with_constant("pupper_v2", parameter, value, tmp_path / "mine.toml")
    with pytest.raises(ConfigError) as refusal:
        load_fleet(path)
    said = str(refusal.value)
    assert said.startswith(f"{path}, its central motor: armature = ") and len(said) < 1000
    assert parameter in said and f"{value:.3g}" in said
    bounds = re.findall(
        r"(armature|gear_stiffness|gear_damping \+ viscous_damping) (above|below) (\S+)", said.split("->")[1]
    )
    assert bounds[0][:2] == ("armature", "above")
    family, values = center("pupper_v2", **{parameter: value})
    for name, side, bound in bounds:
        remedy = float(bound) * (1.01 if side == "above" else 0.99)
        split = {"gear_damping": remedy, "viscous_damping": 0.0} if "+" in name else {name: remedy}
        assert is_stable(family, values | {key: np.array([number]) for key, number in split.items()}), name


@pytest.mark.parametrize("constant", ["slider_stiffness", "bristle_stiffness", "bristle_damping", "gear_hardening"])
def test_everything_that_pulls_at_a_rotor_counts(constant: str):
    family, values = center("foreign_direct")
    assert is_stable(family, values)
    with pytest.raises(ConfigError, match=r"cannot carry gear_stiffness \+ slider_stiffness \+ bristle_stiffness"):
        family.require_stable(values | {constant: np.full(1, 1e18)}, "here")


def test_a_gear_is_as_stiff_as_at_the_torque_limit():
    """k·s + c·s³ = torque_limit at s = 0.02 rad: 3·c·s² is added."""
    family, values = center("foreign_direct", gear_stiffness=50.0, gear_hardening=1e5, torque_limit=50 * 0.02 + 0.8)
    values |= {each: np.zeros(1) for each in (FURTHER | {"gear_damping"}) - {"gear_hardening"}}
    least = (50.0 + 3 * 1e5 * 0.02**2) * family.substep**2 / 4.0
    assert not is_stable(family, values | {"armature": np.full(1, 0.999 * least)})
    assert is_stable(family, values | {"armature": np.full(1, 1.001 * least)})


def test_a_motor_drawn_beyond_it_is_refused_before_it_is_simulated():
    fleet = load_fleet("pupper_v2")
    wide = Distribution("lognormal", {"center": 0.003, "spread": 3.0, "center_uncertainty": 0.0})
    fleet = replace(fleet, parameters=fleet.parameters | {"armature": wide})
    with pytest.raises(ConfigError, match=r"fleet pupper_v2, a motor drawn from it: armature = \S+e-0[6-9] kg·m²"):
        fleet.sample(4000, 0)


def test_a_load_too_light_for_its_gear_is_refused_though_its_numbers_are_finite():
    fleet = load_fleet("pupper_v2")
    stiff: Fleet = replace(
        fleet, parameters=fleet.parameters | {"gear_stiffness": Distribution("constant", {"center": 2e4})}
    )
    motors = stiff.sample(12, 0)
    with pytest.raises(ConfigError, match=r"diverges on a load of .*its gear, 2e\+04 N·m/rad"):
        record(motors, bench_preset("rollout").for_robot(PUPPER_V2), 60, 0, stiff)
