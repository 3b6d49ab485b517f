"""PyBullet keeps mechanics in closed form, reflected inertia included, and agrees with MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from dog import LEGS_TOML, quadruped, written

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.locomotion.gait import open_loop_gait, walker_arrays
from motorprior.robots.load import load_robot
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import GRAVITY
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.physics import physics_step
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")

PD = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003, delay=0.006)
PHYSICAL = load_fleet("pupper_v2").sample(12, np.random.default_rng(0)).actuator()

SHANK_MASS = 0.0381
"""Mass of the shank [kg]."""

SHANK_X = -0.00075
SHANK_Z = -0.0658
"""Centre of mass of the shank relative to the knee [m]."""

KNEE_INERTIA = 1.8e-4 + SHANK_MASS * (SHANK_X**2 + SHANK_Z**2)
"""Inertia of the shank about the knee [kg·m²]."""


@pytest.fixture(params=["ideal_pd", "physical", "grey_box"])
def motors(request, grey_box) -> tuple[str, Actuator]:
    z = np.random.default_rng(1).standard_normal((12, 3))
    boxes = GreyBoxActuator(grey_box(spread=0.1), z)
    actuators = {"ideal_pd": PD, "physical": PHYSICAL, "grey_box": boxes}
    return request.param, actuators[request.param]


@pytest.fixture
def make():
    """Function that makes a suspended robot; its worlds are closed after the test."""
    worlds = []

    def world() -> BulletWorld:
        worlds.append(BulletWorld(PUPPER_V2, suspended=True))
        return worlds[-1]

    yield world
    for made in worlds:
        made.close()


def trot(steps):
    """(steps, 12) targets [rad] of a slow trot."""
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
    """(steps, 12) joint angles [rad] of a suspended robot released in ``pose``."""
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
    # The thighs hang down, and rotors of 1e3 kg·m² keep them there.
    rotors = np.array([1e3, 1e3, armature] * 4)
    limp = IdealPd.without_friction(np.zeros(12), np.zeros(12), np.ones(12), rotors, np.zeros(12))
    amplitude = 0.1
    rest = -np.arctan2(-SHANK_X, -SHANK_Z)
    world = make() if engine == "pybullet" else World(PUPPER_V2, 0.001, suspended=True)

    angles = moved(world, limp, np.tile([0.0, 0.0, rest + amplitude], 4), 1000)

    # (KNEE_INERTIA + armature)·ddq = -m·g·l·sin(q - rest)
    weight = SHANK_MASS * GRAVITY * np.hypot(SHANK_X, SHANK_Z)
    wave = np.sqrt(weight / (KNEE_INERTIA + armature))
    t = 0.001 * np.arange(1, 1001)
    swing = np.tile(amplitude * np.cos(wave * t), (4, 1)).T
    # Euler errs by dt·wave/2 of the amplitude, 4e-4 rad; a finite swing is slower by amplitude²/16,
    # 5e-4 rad in 1 s.
    np.testing.assert_allclose(angles[:, 2::3] - rest, swing, atol=1.2e-3)
    assert np.abs(np.delete(angles, np.s_[2::3], axis=1)).max() < 1e-3


TOLERANCE = {"physical": (1e-9, 1e-6), "ideal_pd": (1e-5, 1e-3), "grey_box": (0.004, 0.25)}
"""Largest differences of suspended joints [rad] and their torques [N·m] over 1 s.

physical: rounding. ideal_pd: the solver of the rotors' gears. grey_box: the damping of a gear and
of its stiffness, which is explicit here. A blow through the backlash is another one and falls in
another millisecond, so that torques differ by a fifth of their limit for that time.
"""


def test_a_suspended_robot_trots_as_in_mujoco(make, motors):
    # Without contacts both engines integrate the same equations.
    name, actuator = motors
    targets = trot(100)

    in_mujoco = replay(World(PUPPER_V2, 0.001, suspended=True), actuator, targets)
    joint_pos, joint_torque = played(make(), actuator, targets)

    angle_tolerance, torque_tolerance = TOLERANCE[name]
    np.testing.assert_allclose(joint_pos, in_mujoco.joint_pos, atol=angle_tolerance)
    assert np.abs(joint_torque - in_mujoco.joint_torque).max() < torque_tolerance
    assert np.ptp(joint_pos, axis=0)[1::3].min() > 0.2


def test_a_users_robot_trots_as_in_mujoco(tmp_path: Path):
    # a trunk whose principal axes are not those of the base, and a joint with another zero
    trunk = 'size="0.2 0.1 0.05" mass="3"'
    xml = quadruped().replace(trunk, f'{trunk} pos="0.02 0 0.01" euler="10 20 0"')
    xml = xml.replace('name="FR_k"', 'name="FR_k" ref="10"')
    robot = load_robot(written(tmp_path, LEGS_TOML, "dog", xml))
    actuator = IdealPd.uniform(12, kp=20.0, kd=0.5, torque_limit=10.0, armature=0.003, delay=0.006)
    targets = open_loop_gait(walker_arrays(robot), 100, 0.15, 1.5, 0.0, 1.0)

    in_mujoco = replay(World(robot, 0.001, suspended=True), actuator, targets)
    suspended = BulletWorld(robot, suspended=True)
    joint_pos, _ = played(suspended, actuator, targets)
    suspended.close()

    np.testing.assert_allclose(joint_pos, in_mujoco.joint_pos, atol=1e-5)
    assert np.ptp(joint_pos, axis=0)[1::3].min() > 0.1

    # both robots fall and turn as their feet are drawn up
    drawn_up = robot.nominal_pose + np.tile([0.1, 0.4, -0.6], 4)
    on_the_ground = BulletWorld(robot)
    in_bullet = on_the_ground.reset(actuator)
    free = World(robot, 0.001).reset(actuator)
    state = in_bullet.state()
    reference = free.state()
    for _ in range(8):
        state = in_bullet.step(drawn_up)
        reference = free.step(drawn_up)
    on_the_ground.close()

    np.testing.assert_allclose(state.base_pos, reference.base_pos, atol=5e-4)
    np.testing.assert_allclose(state.base_quat, reference.base_quat, atol=1e-3)
    np.testing.assert_allclose(state.base_ang_vel, reference.base_ang_vel, atol=0.03)
    assert np.abs(reference.base_quat[1:]).max() > 1e-3
