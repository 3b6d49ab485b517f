"""MuJoCo's world keeps closed-form mechanics, forgets its past at reset and reports its faults."""

from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policies import random_policy

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.model_source import ModelFile
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.physics import FAULTS, physics_step
from motorprior.simulation.playback import replay
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator
from motorprior.simulation.world import World

PD = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003)


def test_the_reported_torque_is_the_motors_with_the_damping_of_the_engine():
    world = World(PUPPER_V2, suspended=True)
    simulation = world.reset(PD)
    world.data.qvel[:] = np.linspace(-3, 3, 12)
    error = np.linspace(0.1, -0.1, 12)
    speed = world.data.qvel.copy()
    target = PUPPER_V2.nominal_pose + error

    torque_squared_sum = physics_step(simulation.arrays, simulation.motors, target)

    law = np.clip(8.8 * error - 0.84 * speed, -1.26, 1.26)
    np.testing.assert_allclose(world.data.qfrc_applied, law + 0.84 * speed, atol=1e-12)
    # The engine damps implicitly, by the velocity at the end of the step.
    torque = law + 0.84 * (speed - world.data.qvel)
    np.testing.assert_allclose(simulation.arrays.torque, torque, atol=1e-12)
    assert torque_squared_sum == pytest.approx(np.sum(torque**2))
    assert np.max(np.abs(torque - law)) > 1e-3


def test_the_engine_takes_the_damping_that_the_motors_renew(grey_box):
    world = World(PUPPER_V2, suspended=True)
    target = PUPPER_V2.nominal_pose + 0.2
    simulation = world.reset(GreyBoxActuator(grey_box(), np.zeros((12, 3))))
    dampings = []

    for _ in range(60):
        physics_step(simulation.arrays, simulation.motors, target)
        damping = simulation.motors.damping
        np.testing.assert_array_equal(world.model.dof_damping, damping)
        dampings.append(damping.copy())

    assert np.min(dampings) == 0.0, "within the backlash"
    assert np.max(dampings) > 0.0, "in contact"
    world.reset(PD)
    np.testing.assert_array_equal(world.model.dof_damping, 0.84)


def test_a_reset_world_moves_as_a_new_one():
    targets = PUPPER_V2.nominal_pose + np.random.default_rng(0).uniform(-0.3, 0.3, (30, 12))
    fresh = World(PUPPER_V2)
    used = World(PUPPER_V2)
    heavy = IdealPd.uniform(12, kp=3.0, kd=0.1, torque_limit=5.0, armature=0.02, delay=0.02)
    replay(used, heavy, -targets)  # other motors, other fall
    used.data.qfrc_applied[:] = 7.0

    in_fresh = replay(fresh, PD, targets)
    in_used = replay(used, PD, targets)

    for name in ("joint_pos", "joint_torque", "measured_joint_pos", "base"):
        np.testing.assert_array_equal(getattr(in_fresh, name), getattr(in_used, name))


@pytest.fixture
def in_tmp_path(tmp_path):
    """MuJoCo may write its log into the working folder."""
    with chdir(tmp_path):
        yield


BROKEN = replace(PD, kp=np.full(12, 1e300), torque_limit=np.full(12, 1e308))
NAN = replace(PD, kd=np.full(12, np.nan))


@pytest.mark.parametrize("motors", [BROKEN, NAN], ids=["absurd gains", "NaN"])
@pytest.mark.usefixtures("in_tmp_path")
def test_a_state_that_is_not_finite_is_fault_1_and_ends_the_episode_with_no_reward(motors):
    simulator = WalkSimulator(Scene(PUPPER_V2, lambda rng: motors))

    episode = simulator.run(random_policy(1.0, seed=0), seed=0)

    assert episode.fault == 1
    assert episode.steps < 250
    assert np.isfinite(episode.total)
    assert np.all(np.isfinite(episode.mean))
    assert np.all(episode.displacement == 0.0)


@pytest.mark.parametrize("motors", [BROKEN, NAN], ids=["absurd gains", "NaN"])
@pytest.mark.usefixtures("in_tmp_path")
def test_a_replay_whose_state_is_not_finite_is_a_simulation_fault(motors):
    targets = np.tile(PUPPER_V2.nominal_pose + 0.1, (5, 1))
    with pytest.raises(SimulationFault, match="not finite"):
        replay(World(PUPPER_V2), motors, targets)


@pytest.mark.usefixtures("in_tmp_path")
def test_full_memory_ends_the_compiled_episode_with_its_name():
    # 4 kB hold a robot in the air, without constraints. The first touch of the ground, with four
    # feet, needs more.
    xml = PUPPER_V2.model.path.read_text()
    path = Path("small.xml").resolve()
    path.write_text(xml.replace("<worldbody>", '<size memory="4K"/><worldbody>', 1))
    cramped = replace(PUPPER_V2, model=ModelFile.of(path))
    standing = WalkConfig(episode_steps=60, commands=Commands.steady(0.0))
    simulator = WalkSimulator(Scene(cramped, lambda rng: PD, standing))

    episode = simulator.run(PolicyShape(12).untrained(), seed=0)

    assert episode.fault == 2
    assert "memory" in FAULTS[episode.fault]
    assert episode.steps < 60
    assert np.isfinite(episode.total)
