"""Targets of a whole robot stay within the amplitude and speed that the user asked for."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.excitation.registry import EXCITATIONS
from motorprior.excitation.robot_targets import OF_ROBOTS, hardware_targets, joints_of
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@given(
    name=st.sampled_from([*EXCITATIONS, *OF_ROBOTS]),
    joint=st.sampled_from(["all", "FR", "knee", "RL_hip"]),
    seconds=st.floats(1.0, 20.0),
    amplitude=st.floats(0.05, 1.5),
    speed=st.floats(0.5, 20.0),
    seed=st.integers(0, 100),
)
@settings(max_examples=40, deadline=None)
def test_an_excitation_stays_within_amplitude_and_speed(
    name, joint, seconds, amplitude, speed, seed
):
    joints = joints_of(PUPPER_V2, joint)
    targets = hardware_targets(PUPPER_V2, name, joints, seconds, amplitude, speed, seed)

    away = targets - PUPPER_V2.nominal_pose
    assert np.abs(away).max() <= amplitude + 1e-9
    assert np.all(targets >= PUPPER_V2.lower)
    assert np.all(targets <= PUPPER_V2.upper)
    assert np.abs(away[0]).max() == 0.0
    assert np.abs(away[-1]).max() < 1e-9

    moving = set(np.flatnonzero(np.abs(away).max(axis=0)))
    assert moving
    assert moving <= set(joints)

    # steps, and the second half of varied targets, have no speed limit
    smooth = targets[: len(targets) // 2] if name == "varied" else targets
    if name != "steps":
        assert np.abs(np.diff(smooth, axis=0)).max() <= speed * PUPPER_V2.control_dt + 1e-9
