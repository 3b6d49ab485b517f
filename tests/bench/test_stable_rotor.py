"""Motors whose rotor cannot be simulated on its gear are refused by name and bound, before anything is simulated."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.bench.distribution import Distribution
from motorprior.bench.families import FAMILIES, Family
from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError

FURTHER = {"slider_stiffness", "bristle_stiffness", "bristle_damping", "gear_hardening"}
"""What else is a spring or damps a rotor."""


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


def test_a_motor_drawn_beyond_it_is_refused_before_it_is_simulated():
    fleet = load_fleet("pupper_v2")
    wide = Distribution("lognormal", {"center": 0.003, "spread": 3.0, "center_uncertainty": 0.0})
    fleet = replace(fleet, parameters=fleet.parameters | {"armature": wide})
    with pytest.raises(ConfigError, match=r"fleet pupper_v2, a motor drawn from it: armature = \S+e-0[6-9] kg·m²"):
        fleet.sample(4000, 0)
