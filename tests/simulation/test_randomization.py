"""Randomisation is off by default; each range has its stated effect, the same in both engines."""

from dataclasses import fields, replace

import numpy as np
import pytest
from drawn_motors import draw_pd
from policies import random_policy
from scipy.spatial.transform import Rotation

from motorprior.actuator.actuator import ConstantFactors
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.locomotion.control_step import SensorErrors, apply_sensor_errors, perfect_sensors
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.physics import hold_target, physics_step, read_joints
from motorprior.simulation.randomization import Randomization, nominal_domain
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator
from motorprior.simulation.world import MujocoSimulation, World

EVERYTHING = Randomization(
    armature=(0.0, 0.002),
    damping=(0.0, 0.05),
    friction=(0.6, 1.4),
    mass=(0.8, 1.2),
    com=0.01,
    gravity_tilt=0.05,
    encoder_offset=0.02,
    joint_noise=0.002,
    tilt_noise=0.01,
    rate_noise=0.05,
    sensor_delay=(0.004, 0.025),
    command_delay=(0.001, 0.018),
    push=0.1,
    push_interval=0.2,
    gyro_bias=0.02,
    sensor_jitter=0.008,
    dropped=0.1,
    command_jitter=0.006,
    strength=(0.6, 1.1),
    kp=(0.7, 1.3),
    kd=(0.5, 1.5),
    torque_limit=(0.3, 1.1),
    coulomb=(0.0, 2.0),
)
RANGES = [field.name for field in fields(Randomization) if field.name != "push_interval"]
PD = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003)
WITH_FRICTION = replace(PD, coulomb=np.full(12, 0.05))
POLICY = random_policy(0.05, seed=1, mean=0.1, std=0.7)
STEPS = 100
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def draw_friction_pd(rng):
    return replace(draw_pd(rng), coulomb=np.full(12, 0.05))


def only_range(name, push_interval):
    """The range ``name`` of EVERYTHING, without the others."""
    return replace(Randomization(push_interval=push_interval), **{name: getattr(EVERYTHING, name)})


def episode(randomization):
    """An episode of 60 steps of the same policy, motors and seed."""
    scene = Scene(PUPPER_V2, draw_friction_pd, WalkConfig(60, randomization=randomization))
    return WalkSimulator(scene).run(POLICY, 3, trace=True)


@pytest.mark.parametrize("name", RANGES)
def test_every_range_alone_changes_the_walk_and_the_same_seed_repeats_it(name):
    randomization = only_range(name, push_interval=0.2)

    walk = episode(randomization)

    assert not np.array_equal(walk.trace, episode(Randomization()).trace)
    np.testing.assert_array_equal(walk.trace, episode(randomization).trace)


def test_draws_fill_their_ranges():
    domains = [EVERYTHING.domain(PUPPER_V2, seed, STEPS) for seed in range(300)]

    for name in ("armature", "damping", "friction", "mass", "strength", *ConstantFactors._fields):
        if name in ConstantFactors._fields:
            values = np.array([getattr(domain.factors, name) for domain in domains])
        else:
            values = np.array([getattr(domain, name) for domain in domains])
        low, high = getattr(EVERYTHING, name)
        margin = 0.1 * (high - low)
        assert low <= values.min() < low + margin, name
        assert high - margin < values.max() <= high, name

    gravity = np.array([domain.gravity for domain in domains])
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 9.81)
    tilt = np.arccos(-gravity[:, 2] / 9.81)
    assert 0.045 < tilt.max() <= 0.05
    assert np.abs(gravity[:, :2].mean(axis=0)).max() < 0.05
    assert np.abs([domain.com for domain in domains]).max() <= 0.01


CHANGED_BY_A_DOMAIN = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "pair_friction",
    "body_subtreemass",
    "body_invweight0",
)


def test_friction_and_inertia_reach_mujoco_until_the_next_reset():
    domain = EVERYTHING.domain(PUPPER_V2, 1, STEPS)
    world = World(PUPPER_V2)
    plain = World(PUPPER_V2).model

    world.reset(WITH_FRICTION, domain=domain)
    inertia = plain.body_inertia[1:] * domain.mass[:, None]
    np.testing.assert_allclose(world.model.body_inertia[1:], inertia)
    np.testing.assert_allclose(world.model.pair_friction[:, 0], 0.45 * domain.friction)

    world.reset(PD)
    for name in CHANGED_BY_A_DOMAIN:
        np.testing.assert_array_equal(getattr(world.model, name), getattr(plain, name))


def test_an_encoder_zero_shifts_what_is_measured_and_where_the_motor_goes():
    offset = np.linspace(-0.05, 0.05, 12)
    world = World(PUPPER_V2, suspended=True)
    world.model.opt.gravity[:] = 0.0
    simulation = world.reset(PD, domain=replace(nominal_domain(PUPPER_V2), encoder_offset=offset))
    target = PUPPER_V2.nominal_pose + 0.1

    for _ in range(200):
        hold_target(simulation.arrays, simulation.motors, target)

    measured = np.zeros(12)
    read_joints(simulation.arrays, simulation.motors, measured)
    np.testing.assert_allclose(measured, target, atol=1e-4)
    np.testing.assert_allclose(world.data.qpos, target - offset, atol=1e-4)


def test_the_previous_target_stays_in_force_until_a_late_one_arrives():
    targets = PUPPER_V2.nominal_pose + np.random.default_rng(0).uniform(-0.2, 0.2, (20, 12))
    delays = Randomization(command_jitter=0.01).domain(PUPPER_V2, 1, 20).command_jitter
    assert 0.0 <= delays.min() < 0.002
    assert 0.008 < delays.max() <= 0.01
    world = World(PUPPER_V2, physics_dt=0.001, suspended=True)
    simulation = world.reset(PD, domain=replace(nominal_domain(PUPPER_V2), command_jitter=delays))
    reference_world = World(PUPPER_V2, physics_dt=0.001, suspended=True)
    reference = reference_world.reset(PD)
    previous_target = PUPPER_V2.nominal_pose

    for target, delay in zip(targets, delays, strict=True):
        hold_target(simulation.arrays, simulation.motors, target)
        for substep in range(10):
            in_force = previous_target if substep < round(delay / 0.001) else target
            physics_step(reference.arrays, reference.motors, np.ascontiguousarray(in_force))
        previous_target = target
        np.testing.assert_array_equal(world.data.qpos, reference_world.data.qpos)


SOFT = IdealPd.uniform(12, kp=8.8, kd=0.3, torque_limit=1.26, armature=0.003)


def falling(engine, randomization):
    """(30, 19) measured joints, base positions and quaternions of a robot that kicks in the air."""
    walk = WalkConfig(30, randomization=randomization, engine=engine)
    scene = Scene(PUPPER_V2, lambda rng: SOFT, walk, 0.001)
    world = scene.world()
    motors, domain = scene.sample(3)
    simulation = world.reset(motors, domain=domain)
    if isinstance(simulation, MujocoSimulation):
        simulation.world.data.qpos[2] += 10.0  # no contact
    else:
        call = simulation.client.call
        (x, y, z), quat = call("getBasePositionAndOrientation", simulation.robot_id)
        call("resetBasePositionAndOrientation", simulation.robot_id, [x, y, z + 10.0], quat)
    targets = PUPPER_V2.nominal_pose + np.random.default_rng(0).uniform(-0.2, 0.2, (30, 12))
    rows = []
    for target in targets:
        state = simulation.step(target)
        rows.append(np.r_[state.measured_joint_pos, state.base_pos, state.base_quat])
    world.close()
    return np.array(rows)


IN_THE_AIR = (
    "armature",
    "damping",
    "mass",
    "com",
    "gravity_tilt",
    "encoder_offset",
    "command_delay",
    "command_jitter",
)


@pytest.mark.parametrize("name", [*IN_THE_AIR, "push", "strength", "kp", "kd", "torque_limit"])
def test_every_range_moves_a_falling_robot_alike_in_both_engines(name):
    pytest.importorskip(
        "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
    )
    randomization = only_range(name, push_interval=0.1)

    mujoco = falling("mujoco", randomization)
    bullet = falling("pybullet", randomization)

    np.testing.assert_allclose(mujoco, bullet, atol=1.5e-5)  # [rad] and [m]; measured: 7e-6
    assert np.abs(bullet - falling("pybullet", Randomization())).max() > 3e-4


def test_on_a_slope_roll_and_pitch_are_relative_to_gravity():
    """The rotation that takes gravity down turns the robot to the observed roll and pitch."""
    slope = Randomization(gravity_tilt=0.4)
    rng = np.random.default_rng(5)

    for seed in range(20):
        up = slope.sensors(PUPPER_V2, seed, STEPS).up
        gravity = slope.domain(PUPPER_V2, seed, STEPS).gravity
        np.testing.assert_allclose(gravity, -9.81 * up, atol=1e-12)

        attitude = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3))
        sensors = perfect_sensors()._replace(up=up)
        observation = np.arange(23.0)
        apply_sensor_errors(sensors, 0, attitude.as_quat(scalar_first=True), observation)

        level = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
        _, pitch, roll = (level * attitude).as_euler("ZYX")
        np.testing.assert_allclose(observation, [roll, pitch, *np.arange(2.0, 23.0)], atol=1e-9)


@pytest.mark.parametrize("delay", [0.4, 1.0, 2.75])
def test_delayed_readings_are_interpolated_and_the_state_of_the_gait_is_not_delayed(delay):
    truth = np.random.default_rng(0).standard_normal((10, 23))
    delays = np.full(100, delay)
    history = np.zeros((int(delay) + 2, 17))
    sensors = SensorErrors(np.zeros((0, 17)), delays, history, np.array([0.0, 0.0, 1.0]))

    for step, row in enumerate(truth):
        observation = row.copy()
        apply_sensor_errors(sensors, step, UPRIGHT, observation)

        sampled_at = max(step - delay, 0.0)
        readings = [np.interp(sampled_at, np.arange(10), truth[:, i]) for i in range(17)]
        np.testing.assert_allclose(observation, [*readings, *row[17:]], atol=1e-12)
