"""The compiled episode is the Python episode bit for bit, on any number of threads."""

import numpy as np
import pytest
from drawn_motors import draw_pd
from grey_boxes import make_grey_box
from policies import random_policy

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.latent import LatentNetwork, NetworkActuator
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import TaskWeights
from motorprior.locomotion.policy import PolicyArrays
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import EnvSimulator, Scene, WalkConfig, WalkSimulator

STEPS = 120
FLEET = load_fleet("pupper_v2")


def pd_network():
    """A latent network that acts like a PD of 9 N·m/rad and 0.8 N·m·s/rad; z varies it."""
    w1 = np.zeros((4, 8))
    w2 = np.zeros((8, 8))
    # Inputs are the newest error and velocity; softsign is nearly linear at such values.
    w1[0, 0] = 0.1
    w1[2, 0] = -0.18
    w2[0, 0] = 1.0
    v1 = 0.002 * np.random.default_rng(0).standard_normal((3, 8))
    return LatentNetwork(
        w1=w1,
        v1=v1,
        b1=np.zeros(8),
        w2=w2,
        b2=np.zeros(8),
        w3=np.r_[1.0, np.zeros(7)],
        b3=np.array(0.0),
        log_armature=np.array(np.log(0.003)),
        armature_slope=np.array([0.2, 0.0, 0.0]),
        taps=(0, 2),
        period=0.002,
        error_scale=0.1,
        velocity_scale=2.0,
        torque_scale=9.0,
        torque_limit=1.26,
        has_armature=True,
    )


def draw_physical(rng):
    return FLEET.sample(12, rng).actuator()


def draw_latent(rng):
    return NetworkActuator(pd_network(), rng.standard_normal((12, 3)))


def draw_grey_box(rng):
    return GreyBoxActuator(make_grey_box(spread=0.1), rng.standard_normal((12, 3)))


ACTUATORS = {
    "ideal_pd": (draw_pd, 0.002),
    "physical": (draw_physical, 0.001),
    "latent": (draw_latent, 0.001),
    "grey_box": (draw_grey_box, 0.002),
}
"""Function that draws the motors, and physics step [s]."""

POLICY = random_policy(0.05, seed=1, mean=0.1, std=0.7)
CLUMSY = random_policy(3.0, seed=4, std=0.5)


def assert_equal(compiled, python):
    for name in ("total", "steps", "fault", "speed_error", "displacement", "mean", "m2"):
        np.testing.assert_array_equal(getattr(compiled, name), getattr(python, name))
    np.testing.assert_array_equal(compiled.trace[:, :7], python.trace[:, :7])


@pytest.mark.parametrize("actuator_name", ACTUATORS)
@pytest.mark.parametrize(
    ("policy", "falls"), [(POLICY, False), (CLUMSY, True)], ids=["walks", "falls"]
)
def test_a_compiled_episode_equals_the_python_episode_bit_for_bit(
    actuator_name, policy: PolicyArrays, falls
):
    draw, physics_dt = ACTUATORS[actuator_name]
    walk = WalkConfig(episode_steps=STEPS, task=TaskWeights(lateral=0.3, heading=0.1))
    scene = Scene(PUPPER_V2, draw, walk, physics_dt)
    compiled = WalkSimulator(scene)
    python = EnvSimulator(scene)

    for seed in (0, 1):
        episode = compiled.run(policy, seed, trace=True)
        assert_equal(episode, python.run(policy, seed, trace=True))
        assert (episode.steps < STEPS) == falls


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
    push=0.02,
    push_interval=0.2,
    gyro_bias=0.05,
    sensor_jitter=0.008,
    dropped=0.1,
    command_jitter=0.006,
    strength=(0.9, 1.1),
    kp=(0.9, 1.1),
    kd=(0.9, 1.1),
    torque_limit=(0.9, 1.1),
)


def test_commands_randomization_and_hidden_units_are_the_same_in_both_loops():
    walk = WalkConfig(STEPS, TaskWeights(), EVERYTHING, Commands(hold=0.3, straight=0.2))
    policy = random_policy(0.05, seed=4, units=6)
    scene = Scene(PUPPER_V2, draw_pd, walk)
    compiled = WalkSimulator(scene)
    python = EnvSimulator(scene)

    for seed in (0, 1):
        episode = compiled.run(policy, seed, trace=True)
        assert_equal(episode, python.run(policy, seed, trace=True))
        assert episode.m2[19:21].min() > 0.0, "speed and turn were commanded, and changed"


@pytest.mark.parametrize("actuator_name", ACTUATORS)
def test_the_zero_policy_trots_and_stays_up(actuator_name):
    draw, physics_dt = ACTUATORS[actuator_name]
    walk = WalkConfig(episode_steps=STEPS, commands=Commands.steady(0.3))
    simulator = WalkSimulator(Scene(PUPPER_V2, draw, walk, physics_dt))

    episode = simulator.run(PolicyShape(12).untrained(), 0, trace=True)

    assert episode.steps == STEPS
    assert episode.fault == 0
    assert episode.motion.shape == (STEPS, 6 + 24)
    swings = np.ptp(episode.trace[:, 7:], axis=0)
    assert swings[1::3].min() > 0.05, "every hip swings"
