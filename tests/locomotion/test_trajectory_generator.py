"""Feet in stance move with the ground and carry the weight; feet in swing return smoothly."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.locomotion.gait import (
    add_support,
    foot_path,
    joint_targets,
    leg_angles,
    walker_arrays,
)
from motorprior.robots.build_model import build_model
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

WALKER = walker_arrays(PUPPER_V2)
FREQUENCY = WALKER.frequency
LIFT = WALKER.swing_height
LEGS = len(PUPPER_V2.legs)


def targets(
    phase,
    forward=0.3,
    yaw_rate=0.0,
    height=0.0,
    ratio=1.0,
    lift=LIFT,
    walker=WALKER,
    slope=(0.0, 0.0),
):
    out = np.full(PUPPER_V2.num_joints, np.nan)
    joint_targets(walker, phase, forward, yaw_rate, FREQUENCY, height, slope, ratio, lift, out)
    return out


@pytest.fixture(scope="module")
def feet():
    """Function from (steps, joints) angles to (steps, legs, 3) feet in the body's frame [m].

    It uses the kinematics of MuJoCo.
    """
    model = build_model(PUPPER_V2, suspended=True)
    data = mujoco.MjData(model)
    geoms = [model.geom(leg.foot).id for leg in PUPPER_V2.legs]

    def places(angles: np.ndarray) -> np.ndarray:
        feet_of_steps = []
        for row in angles:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            feet_of_steps.append(data.geom_xpos[geoms] - data.xpos[1])
        return np.array(feet_of_steps)

    return places


def stance_of(leg: int, ratio: float) -> np.ndarray:
    """Phases of the gait in the stance of a leg."""
    share = 1.0 / (1.0 + ratio)
    return (np.linspace(1e-6, share - 1e-6, 80) - WALKER.phases[leg]) % 1.0


def velocities(feet, leg: int, phases: np.ndarray, **command) -> np.ndarray:
    """(phases, 3) velocities of a foot relative to the body [m/s].

    They are central differences over 2 µs.
    """
    step = 1e-6 * FREQUENCY
    earlier = np.array([targets(phase - step, **command) for phase in phases])
    later = np.array([targets(phase + step, **command) for phase in phases])
    return (feet(later)[:, leg] - feet(earlier)[:, leg]) / 2e-6


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("speed", [-0.2, 0.1, 0.5])
def test_a_foot_in_stance_moves_back_at_the_commanded_speed(feet, speed, ratio):
    for leg in range(LEGS):
        phases = stance_of(leg, ratio)[1:-1]
        velocity = velocities(feet, leg, phases, forward=speed, ratio=ratio)
        ground = np.tile([-speed, 0.0, 0.0], (len(phases), 1))
        np.testing.assert_allclose(velocity, ground, atol=1e-6)


@pytest.mark.parametrize(("speed", "turn"), [(0.0, 0.6), (0.0, -0.6), (0.3, 0.5)])
def test_a_foot_in_stance_moves_as_the_ground_does_under_a_turning_body(feet, speed, turn):
    for leg, (x, y) in enumerate(WALKER.nominal_feet[:, :2]):
        phases = stance_of(leg, 1.0)[1:-1]
        velocity = velocities(feet, leg, phases, forward=speed, yaw_rate=turn)
        ground = np.tile([-speed + turn * y, -turn * x], (len(phases), 1))
        # The leg turns about its abduction axis instead of the hip: a few percent of a slow motion.
        np.testing.assert_allclose(velocity[:, :2], ground, atol=0.004)
        assert np.abs(velocity[:, 2]).max() < 0.03


@pytest.mark.parametrize("share", [0.2, 0.5, 0.75])
def test_the_path_of_a_foot_is_continuous_and_lifts_it_in_swing_only(share):
    path = np.array([foot_path(phase, share) for phase in np.arange(0.0, 1.0, 1e-3)])
    height = path[:, 1]

    assert np.abs(np.diff(path, axis=0)).max() < 0.02
    assert height.max() == pytest.approx(1.0, abs=1e-4)
    assert np.all(height >= 0.0)
    assert np.mean(height == 0.0) == pytest.approx(share, abs=2e-3)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.75])
def test_a_foot_touches_down_and_lifts_off_at_the_speed_of_stance(share):
    small = 1e-7

    def position(phase):
        return np.array(foot_path(phase % 1.0, share))

    def speed(phase):
        return (position(phase + small)[0] - position(phase - small)[0]) / (2 * small)

    for corner in (0.0, share):
        jump = position(corner + small) - position(corner - small)
        assert np.abs(jump).max() < 1e-5
        for phase in (corner - 3 * small, corner + 3 * small):
            assert speed(phase) == pytest.approx(-1.0 / share, rel=1e-4)


def test_a_swing_lifts_the_foot_by_the_stated_height(feet):
    for leg in range(LEGS):
        height = feet(np.array([targets(p) for p in np.linspace(0.0, 1.0, 200)]))[:, leg, 2]
        assert np.ptp(height) == pytest.approx(LIFT, rel=2e-3)
        stance = feet(np.array([targets(p) for p in stance_of(leg, 1.0)]))[:, leg, 2]
        assert np.ptp(stance) < 1e-9 and height.min() == pytest.approx(stance[0])


def support(phase, share):
    """(legs, 3) torques of the support [N·m], from the compliance of the robot's motors."""
    out = np.zeros(PUPPER_V2.num_joints)
    add_support(WALKER, phase, 1.0, share, targets(phase), out)
    return (out / WALKER.compliance).reshape(LEGS, 3)


def test_legs_in_stance_share_the_weight_and_legs_in_swing_carry_nothing(feet):
    """Virtual work: a foot pushed down by F does the work F dz when a joint moves."""
    for phase in (0.1, 0.3, 0.6, 0.9):
        pose = targets(phase)
        torques = support(phase, 1.0)
        assert not torques[:, 0].any(), "abductions carry nothing"

        for leg, joints in enumerate(WALKER.legs):
            in_stance = (phase + WALKER.phases[leg]) % 1.0 < 0.5
            for column, joint in enumerate(joints[1:], start=1):
                nudge = 1e-6 * np.eye(PUPPER_V2.num_joints)[joint]
                low, high = feet(np.array([pose - nudge, pose + nudge]))[:, leg, 2]
                work = -(high - low) / 2e-6 * WALKER.weight / 2.0
                torque = work if in_stance else 0.0
                assert torques[leg, column] == pytest.approx(torque, abs=1e-6)


def test_with_support_a_pd_stands_in_the_commanded_pose_and_without_it_sags():
    motors = IdealPd.uniform(12, PUPPER_V2.joints[0].kp, PUPPER_V2.joints[0].kd, 5.0, 0.003)
    pose = PUPPER_V2.nominal_pose
    supported = pose.copy()
    add_support(WALKER, 0.0, 1.0, 0.0, pose, supported)

    def sag(target):
        played = replay(World(PUPPER_V2), motors, np.tile(target, (100, 1)))
        return PUPPER_V2.standing_height - played.base[-1, 2]

    assert sag(pose) > 0.003  # [m]
    assert abs(sag(supported)) < 0.3 * sag(pose)


def test_the_diagonal_pairs_of_a_trot_touch_down_in_turn():
    names = [leg.name for leg in PUPPER_V2.legs]
    cycle = (np.arange(400) + 0.5) / 400

    down = np.zeros((len(cycle), LEGS), bool)
    for row, phase in enumerate(cycle):
        for leg, phase_of_leg in enumerate(WALKER.phases):
            _, height = foot_path(float((phase + phase_of_leg) % 1.0), 0.5)
            down[row, leg] = height == 0.0

    order = []
    for touchdowns in down & ~np.roll(down, 1, axis=0):
        if touchdowns.any():
            order.append({names[leg] for leg in np.flatnonzero(touchdowns)})
    assert order == [{"FR", "RL"}, {"FL", "RR"}]
    np.testing.assert_allclose(down.mean(axis=0), 0.5, atol=0.005)


@given(
    thigh=st.floats(0.05, 0.5),
    ratio=st.floats(0.5, 2.0),
    hip=st.floats(-3.1, 3.1),
    knee=st.floats(0.06, 3.08),
    side=st.sampled_from([-1.0, 1.0]),
)
@settings(deadline=None)  # the first call compiles
def test_leg_angles_invert_the_reach_for_both_sides_of_the_knee(thigh, ratio, hip, knee, side):
    leg = replace(PUPPER_V2.legs[0], thigh=thigh, shank=ratio * thigh)
    reach = leg.reach(np.array([0.0, hip, side * knee]))

    hip_angle, knee_angle = leg_angles(leg.thigh, leg.shank, *reach, side)

    assert knee_angle == pytest.approx(side * knee, abs=1e-9)
    assert math.remainder(hip_angle - hip, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
