"""Motors whose rotor cannot be simulated on its gear are refused by name and bound, before anything is simulated."""

import numpy as np
import pytest

from motorprior.actuator.families import FAMILIES, Family
from motorprior.actuator.fleet import load_fleet
from motorprior.exceptions import ConfigError

FURTHER = {"slider_stiffness", "bristle_stiffness", "bristle_damping", "gear_hardening"}
"""What else is a spring or damps a rotor."""


def center(name: str, **changes: float) -> tuple[Family, dict[str, np.ndarray]]:
    """The constants of a fleet's central motor, some of them changed."""
    fleet = load_fleet(name)
    values = {parameter: d.center for parameter, d in fleet.parameters.items()} | changes
    return FAMILIES[fleet.family], {
        parameter: np.array([value]) for parameter, value in values.items()
    }


def is_stable(family: Family, values: dict[str, np.ndarray]) -> bool:
    try:
        family.require_stable(values, "here")
    except ConfigError:
        return False
    return True


@pytest.mark.parametrize("name", ["pupper_v2", "foreign_direct"])
@pytest.mark.parametrize(
    ("stiffness", "damping"), [(80.0, 0.03), (2000.0, 0.0), (1.0, 2.0), (500.0, 0.4)]
)
def test_the_bound_is_that_of_the_roots(name: str, stiffness: float, damping: float):
    family, values = center(
        name, gear_stiffness=stiffness, gear_damping=damping, viscous_damping=0.0
    )
    values |= {each: np.zeros(1) for each in FURTHER & values.keys()}
    h = family.kind.bench_step
    found = []
    for armature in np.geomspace(1e-8, 1e-2, 400):
        a = damping * h / armature
        b = stiffness * h * h / armature
        largest = np.abs(np.linalg.eigvals(np.array([[1.0 - a, -b], [1.0 - a, 1.0 - b]]))).max()
        found.append(
            is_stable(family, values | {"armature": np.array([armature])})
            == (largest <= 1.0 + 1e-9)
        )
    assert all(found)
