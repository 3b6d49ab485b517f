"""PyBullet keeps mechanics in closed form, reflected inertia included, and agrees with MuJoCo."""

import numpy as np
import pytest

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentNetwork, NetworkActuator
from motorprior.bench.fleet import load_fleet
from motorprior.locomotion.body import body_of
from motorprior.locomotion.trajectory_generator import open_loop_gait
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.urdf import ROTOR_GEAR_RATIO
from motorprior.robots.robot import GRAVITY
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_step import physics_step

pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")

SUSPENDED, STANDING = True, False
PD = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003, delay=0.006)
PHYSICAL = load_fleet("pupper_v2").sample(12, np.random.default_rng(0)).actuator()
KNEE_INERTIA = 1.8e-4 + 0.0381 * (0.00075**2 + 0.0658**2)
"""Of the shank about the knee [kg·m²]."""


def network():
    """A latent network of random weights that is about as stiff as a PD of 6 N·m/rad and 0.3 N·m·s/rad."""
    rng = np.random.default_rng(0)
    w1, w2 = 0.01 * rng.standard_normal((4, 8)), 0.01 * rng.standard_normal((8, 8))
    w1[0, 0], w1[2, 0], w2[0, 0] = 0.1, -0.1, 1.0
    return LatentNetwork(
        w1=w1, v1=0.02 * rng.standard_normal((3, 8)), b1=np.zeros(8), w2=w2, b2=np.zeros(8), w3=np.r_[1.0, np.zeros(7)],
        b3=np.array(0.0), log_armature=np.array(np.log(0.003)), armature_slope=np.array([0.2, 0.0, 0.0]), taps=(0, 2),
        period=0.002, error_scale=0.1, velocity_scale=2.0, torque_scale=6.0, torque_limit=1.26, has_armature=True,
    )  # fmt: skip


LATENT = NetworkActuator(network(), np.random.default_rng(1).standard_normal((12, 3)))


@pytest.fixture(params=["ideal_pd", "latent", "physical", "grey_box"])
def motors(request, grey_box) -> tuple[str, Actuator]:
    z = np.random.default_rng(1).standard_normal((12, 3))
    boxes = GreyBoxActuator(grey_box(spread=0.1), z)
    known = {"ideal_pd": PD, "latent": LATENT, "physical": PHYSICAL, "grey_box": boxes}
    return request.param, known[request.param]


@pytest.fixture
def make():
    """Makes a world and closes it after the test."""
    worlds = []

    def world(suspended: bool) -> BulletWorld:
        worlds.append(BulletWorld(PUPPER_V2, suspended))
        return worlds[-1]

    yield world
    for one in worlds:
        one.close()


def trot(steps):
    body = body_of(PUPPER_V2)._replace(swing_height=0.02)
    return open_loop_gait(body, steps, 0.15, 1.5, 0.0, 1.0, spec.CONTROL_DT)


def played(world, motors, targets):
    """(physics steps, 12) joint angles and torques, and (control steps, 3) base positions, as `replay` records them."""
    arrays, joint_pos, joint_torque, base = world.reset(motors), [], [], []
    for target in targets:
        base.append(world.base()[0])
        for _ in range(world.substeps):
            world.physics_step(arrays, target)
            joint_torque.append(world.torque.copy())
            joint_pos.append(world.joints()[0])
    return np.array(joint_pos), np.array(joint_torque), np.array(base)


def place(world, joint_pos, joint_vel):
    """Put the joints, and the rotors geared to them, there."""
    for name, pos, vel in zip(spec.JOINT_NAMES, joint_pos, joint_vel, strict=True):
        for link, ratio in ((name, 1.0), (f"{name}_rotor", ROTOR_GEAR_RATIO)):
            if link in world._names:
                world.call("resetJointState", world.body, world._names[link], ratio * pos, ratio * vel)
    world._joints = None


def moved(world, motors, pose, steps):
    """(steps, 12) joint angles of a suspended robot let go in ``pose``, in either engine."""
    arrays, angles = world.reset(motors, pose), np.zeros((steps, 12))
    for row in angles:
        if isinstance(world, BulletWorld):
            world.physics_step(arrays, pose)
            row[:] = world.joints()[0]
        else:
            physics_step(world.arrays, arrays, pose)
            row[:] = world.data.qpos
    return angles


@pytest.mark.parametrize("armature", [0.0, 5e-4])
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_limp_shank_is_a_pendulum(make, engine, armature):
    # thighs hang down, held by rotors of 1e3 kg·m²; (KNEE_INERTIA + armature)·ddq = -m·g·l·sin(q - rest)
    mass, x, z, amplitude = 0.0381, -0.00075, -0.0658, 0.1
    rest = -np.arctan2(-x, -z)
    held = IdealPd(np.zeros(12), np.zeros(12), np.ones(12), np.array([1e3, 1e3, armature] * 4), np.zeros(12))
    world = make(SUSPENDED) if engine == "pybullet" else World(PUPPER_V2, 0.001, SUSPENDED)
    angles = moved(world, held, np.tile([0.0, 0.0, rest + amplitude], 4), 1000)
    wave = np.sqrt(mass * GRAVITY * np.hypot(x, z) / (KNEE_INERTIA + armature))
    t = 0.001 * np.arange(1, 1001)
    # Euler errs by dt·wave/2 of the amplitude, 4e-4 rad; a finite swing is slower by amplitude²/16, 5e-4 rad in 1 s
    np.testing.assert_allclose(angles[:, 2::3] - rest, np.tile(amplitude * np.cos(wave * t), (4, 1)).T, atol=1.2e-3)
    assert np.abs(np.delete(angles, np.s_[2::3], axis=1)).max() < 1e-3


@pytest.mark.parametrize(("armature", "damping"), [(0.003, 0.0), (0.003, 0.02), (0.0008, 0.05)])
def test_a_knee_with_reflected_inertia_is_a_damped_oscillator(make, armature, damping):
    # all but the knees held by rotors of 1e3 kg·m²; gravity off; (KNEE_INERTIA + armature)·ddq = -kp·q - damping·dq
    world, kp = make(SUSPENDED), 2.0
    rotors = np.array([1e3, 1e3, armature] * 4)
    motors = IdealPd(np.tile([0, 0, kp], 4), np.tile([0, 0, damping], 4), np.full(12, 1e9), rotors, np.zeros(12))
    arrays = world.reset(motors)
    world.call("setGravity", 0, 0, 0)
    inertia = KNEE_INERTIA + armature
    decay = damping / (2 * inertia)
    wave = np.sqrt(kp / inertia - decay**2)
    angle = []
    target = spec.NOMINAL_POSE + np.tile([0.0, 0.0, 0.2], 4)
    for _ in range(200):
        world.physics_step(arrays, target)
        angle.append(world.joints()[0][2::3])
    t = 0.001 * np.arange(1, 201)[:, None]
    ringing = np.exp(-decay * t) * (np.cos(wave * t) + decay / wave * np.sin(wave * t))
    # Euler errs by about dt·wave/2 of the amplitude: 0.001·42/2·0.2 = 4.2e-3 rad at most
    np.testing.assert_allclose(np.array(angle) - spec.NOMINAL_POSE[2], np.tile(0.2 * (1 - ringing), 4), atol=4.5e-3)


def test_the_same_history_gives_the_same_torque_in_both_engines(make, motors):
    # joints and targets are prescribed; what a gear renews is damped at the speed after the step there, before it here
    (name, actuator), there, here = motors, World(PUPPER_V2, 0.001, SUSPENDED), make(SUSPENDED)
    drawn, drawn_too, alike = there.reset(actuator), here.reset(actuator), np.ones(12, bool)
    leg, largest = np.arange(12), np.zeros(12)
    for step in range(60):
        swing = 2 * np.pi * 3 * 0.001 * step + leg
        q, dq = spec.NOMINAL_POSE + 0.1 * (np.sin(swing) - np.sin(leg)), 0.1 * 2 * np.pi * 3 * np.cos(swing)
        target = spec.NOMINAL_POSE + 0.3 * np.sin(2 * np.pi * 5 * 0.001 * step + 0.5 * leg)
        there.data.qpos[:], there.data.qvel[:] = q, dq
        place(here, q, dq)
        physics_step(there.arrays, drawn, target)
        here.physics_step(drawn_too, target)
        renewed = drawn.damping - actuator.damping
        torque = there.arrays.torque + renewed * there.data.qvel
        np.testing.assert_allclose((here.torque + renewed * dq)[alike], torque[alike], atol=SAME_TORQUE[name])
        alike &= renewed == 0.0  # from its first touch on a gear has a history of its own in each engine
        largest = np.maximum(largest, np.abs(here.torque))
    assert np.all(alike != (name == "grey_box")) and largest.min() > 0.2


SAME_TORQUE = {"physical": 1e-12, "latent": 1e-12, "grey_box": 1e-12, "ideal_pd": 5e-4}
"""[N·m]; the engines damp an ideal PD, and their speeds after a step differ by 3e-4 rad/s."""
TOLERANCE = {
    "physical": (1e-9, 1e-6),
    "latent": (2e-5, 1e-3),
    "ideal_pd": (1e-5, 1e-3),
    "grey_box": (0.004, 0.25),
}
"""Of suspended joints [rad] and torques [N·m] over 1 s: rounding; the solver of the rotors' gears; a gear's damping,
its own and that of its stiffness, which is explicit here: a blow through the play is another, and falls in another
millisecond, so that torques differ by a fifth of their limit for as long."""


def test_a_suspended_robot_trots_as_in_mujoco(make, motors):
    # without contacts both integrate the same equations
    name, actuator = motors
    targets = trot(100)
    there = replay(World(PUPPER_V2, 0.001, SUSPENDED), actuator, targets)
    joint_pos, joint_torque, _ = played(make(SUSPENDED), actuator, targets)
    angle, torque = TOLERANCE[name]
    np.testing.assert_allclose(joint_pos, there.joint_pos, atol=angle)
    assert np.abs(joint_torque - there.joint_torque).max() < torque
    assert np.ptp(joint_pos, axis=0)[1::3].min() > 0.2


def test_only_a_fresh_client_is_exact_and_every_reset_makes_one(make):
    targets = trot(30)
    used, fresh = make(STANDING), make(STANDING)
    played(used, PHYSICAL, -targets)  # other motion, a fall
    for one, other in zip(played(used, PD, targets), played(fresh, PD, targets), strict=True):
        np.testing.assert_array_equal(one, other)
