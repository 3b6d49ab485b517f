"""Loads of changed bodies: a mass on a link, a joint at another angle."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import two_link_arm

from motorprior.logs.loads import LOADS, with_loads
from motorprior.logs.loads_bodies import gravity_levers, link_masses, turned_loads


def test_a_mass_adds_the_loads_of_a_model_with_this_mass(tmp_path: Path):
    distance = 0.25
    mass = 0.2
    without_tool = two_link_arm.robot_of(tmp_path / "without")
    with_tool = two_link_arm.robot_of(tmp_path / "with", mass, distance)
    log = two_link_arm.swing(without_tool, 2.0, 1)
    levers = gravity_levers(log)
    assert levers is not None

    (upper_arm, forearm) = link_masses(log, tuple(log.segment_slices()), levers.carries)

    assert upper_arm is not None
    assert forearm is not None
    assert not upper_arm.external[:, 1].any()  # the elbow does not carry the upper arm
    expected = with_loads(log, with_tool)
    relative_distance = distance / forearm.reach
    powers = mass / forearm.mass * relative_distance ** np.arange(3)
    coefficients = (forearm.inertia, forearm.external, forearm.stiffness)
    for name, of_mass in zip(LOADS, coefficients, strict=True):
        added = getattr(expected, name) - getattr(log, name)
        tolerance = 5e-3 * np.abs(added).max()
        assert of_mass[1:-1] @ powers == pytest.approx(added[1:-1], abs=tolerance)


def test_loads_of_a_turned_joint_are_those_of_the_arm_at_these_angles(tmp_path: Path):
    turn = 0.3
    robot = two_link_arm.robot_of(tmp_path)
    log = two_link_arm.swing(robot, 2.0, 1)

    _, coefficients = turned_loads(log, tuple(log.segment_slices()))

    turned = with_loads(replace(log, joint_pos=log.joint_pos + np.array([0.0, turn])), robot)
    for name, of_turn in zip(LOADS, coefficients, strict=True):
        change = getattr(turned, name) - getattr(log, name)
        tolerance = 5e-3 * np.abs(change).max()
        assert of_turn[1:-1] @ turn ** np.arange(1, 5) == pytest.approx(change[1:-1], abs=tolerance)
