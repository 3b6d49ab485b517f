"""Motors whose rotor is unstable on its gear are rejected before any simulation."""

import numpy as np
import pytest

from motorprior.actuator.families import FAMILIES, Family
from motorprior.actuator.fleet import load_fleet
from motorprior.exceptions import ConfigError

OTHER_STIFFNESS = {"slider_stiffness", "bristle_stiffness", "bristle_damping", "gear_hardening"}
"""Constants other than those of the gear that make a rotor stiffer or damp it."""


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
def test_a_motor_is_rejected_if_a_root_lies_outside_the_unit_circle(
    name: str, stiffness: float, damping: float
):
    family, values = center(
        name, gear_stiffness=stiffness, gear_damping=damping, viscous_damping=0.0
    )
    for parameter in OTHER_STIFFNESS & values.keys():
        values[parameter] = np.zeros(1)
    h = family.kind.bench_step

    for armature in np.geomspace(1e-8, 1e-2, 400):
        # rotor on its gear, semi-implicit Euler: state (velocity·h, twist)
        a = damping * h / armature
        b = stiffness * h * h / armature
        transition = np.array([[1.0 - a, -b], [1.0 - a, 1.0 - b]])
        spectral_radius = np.abs(np.linalg.eigvals(transition)).max()

        changed = values | {"armature": np.array([armature])}
        assert is_stable(family, changed) == (spectral_radius <= 1.0 + 1e-9), armature
