"""PyBullet keeps mechanics in closed form, reflected inertia included, and agrees with MuJoCo."""

import numpy as np
import pytest

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.locomotion.gait import open_loop_gait, walker_arrays
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import GRAVITY
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.physics import physics_step
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")

PD = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003, delay=0.006)
PHYSICAL = load_fleet("pupper_v2").sample(12, np.random.default_rng(0)).actuator()
KNEE_INERTIA = 1.8e-4 + 0.0381 * (0.00075**2 + 0.0658**2)
"""Of the shank about the knee [kg·m²]."""


@pytest.fixture(params=["ideal_pd", "physical", "grey_box"])
def motors(request, grey_box) -> tuple[str, Actuator]:
    z = np.random.default_rng(1).standard_normal((12, 3))
    boxes = GreyBoxActuator(grey_box(spread=0.1), z)
    known = {"ideal_pd": PD, "physical": PHYSICAL, "grey_box": boxes}
    return request.param, known[request.param]


@pytest.fixture
def make():
    """Makes a suspended robot and closes its world after the test."""
    worlds = []

    def world() -> BulletWorld:
        worlds.append(BulletWorld(PUPPER_V2, suspended=True))
        return worlds[-1]

    yield world
    for one in worlds:
        one.close()


def trot(steps):
    walker = walker_arrays(PUPPER_V2)._replace(swing_height=0.02)
    return open_loop_gait(walker, steps, 0.15, 1.5, 0.0, 1.0)


def played(world, motors, targets):
    """(physics steps, 12) joint angles and torques, as `replay` records them."""
    simulation = world.reset(motors)
    joint_pos = []
    joint_torque = []
    for target in targets:
        for _ in range(world.substeps):
            simulation.physics_step(target)
            joint_torque.append(simulation.torque.copy())
            joint_pos.append(simulation.joints()[0])
    return np.array(joint_pos), np.array(joint_torque)


def moved(world, motors, pose, steps):
    """(steps, 12) joint angles of a suspended robot let go in ``pose``, in either engine."""
    simulation = world.reset(motors, pose)
    angles = np.zeros((steps, 12))
    for row in angles:
        if isinstance(world, BulletWorld):
            simulation.physics_step(pose)
            row[:] = simulation.joints()[0]
        else:
            physics_step(simulation.arrays, simulation.motors, pose)
            row[:] = world.data.qpos
    return angles


@pytest.mark.parametrize("armature", [0.0, 5e-4])
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_limp_shank_is_a_pendulum(make, engine, armature):
    # thighs hang down, held by rotors of 1e3 kg·m²; (KNEE_INERTIA + armature)·ddq = -m·g·l·sin(q -
    # rest)
    mass = 0.0381
    x = -0.00075
    z = -0.0658
    amplitude = 0.1
    rest = -np.arctan2(-x, -z)
    held = IdealPd(
        np.zeros(12), np.zeros(12), np.ones(12), np.array([1e3, 1e3, armature] * 4), np.zeros(12)
    )
    world = make() if engine == "pybullet" else World(PUPPER_V2, 0.001, suspended=True)
    angles = moved(world, held, np.tile([0.0, 0.0, rest + amplitude], 4), 1000)
    wave = np.sqrt(mass * GRAVITY * np.hypot(x, z) / (KNEE_INERTIA + armature))
    t = 0.001 * np.arange(1, 1001)
    # Euler errs by dt·wave/2 of the amplitude, 4e-4 rad; a finite swing is slower by amplitude²/16,
    # 5e-4 rad in 1 s
    np.testing.assert_allclose(
        angles[:, 2::3] - rest, np.tile(amplitude * np.cos(wave * t), (4, 1)).T, atol=1.2e-3
    )
    assert np.abs(np.delete(angles, np.s_[2::3], axis=1)).max() < 1e-3


TOLERANCE = {"physical": (1e-9, 1e-6), "ideal_pd": (1e-5, 1e-3), "grey_box": (0.004, 0.25)}
"""Of suspended joints [rad] and torques [N·m] over 1 s: rounding; the solver of the rotors' gears; a gear's damping,
its own and that of its stiffness, which is explicit here: a blow through the play is another, and
falls in another millisecond, so that torques differ by a fifth of their limit for as long."""


def test_a_suspended_robot_trots_as_in_mujoco(make, motors):
    # without contacts both integrate the same equations
    name, actuator = motors
    targets = trot(100)
    there = replay(World(PUPPER_V2, 0.001, suspended=True), actuator, targets)
    joint_pos, joint_torque = played(make(), actuator, targets)
    angle, torque = TOLERANCE[name]
    np.testing.assert_allclose(joint_pos, there.joint_pos, atol=angle)
    assert np.abs(joint_torque - there.joint_torque).max() < torque
    assert np.ptp(joint_pos, axis=0)[1::3].min() > 0.2
