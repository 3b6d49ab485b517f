"""The geared motor's step, traced by LLVM, JAX and numpy, is one motor and obeys its equation of motion.

The equation is solved apart from the step's algebra: the rotor's velocity is its root by bisection. Where a gear
touches or a rotor sticks, a decision within rounding could fall either way in float32; with these seeds none does.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from series import complete

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor import DAMPING, FILTERED_VEL, JOINT_VEL, ROTOR_VEL, TARGET
from motorprior.actuator.geared_motor_constants import MAX_STIFFNESS, step_constants
from motorprior.actuator.geared_motor_step import (
    BASE_STATE,
    EXTRA_DAMPING,
    STRIBECK_VELOCITY,
    MotorState,
    array_arithmetic,
    step,
)
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.optional_terms import TERMS, Conditions
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.networks import objectives
from motorprior.identification.networks.network import import_parameters
from motorprior.identification.presets import PRESETS

MOTORS, STEPS, DT = 24, 100, 0.002
SEED = 4
STATE = ("rotor_pos", "rotor_vel", "filtered", "joint_vel", "damping")
"""Fields of a `MotorState`."""


def rotor_velocity(p, target, r, v, filtered, twist, dq, h):
    """The root v' of armature·(v' - v)/h = law - viscous·v̄ - gear - friction·sign(v'); gear, contact and filter."""
    half, stiffness = 0.5 * p["backlash"], np.minimum(p["gear_stiffness"], MAX_STIFFNESS * p["armature"] / h**2)
    coming = twist + 0.5 * h * (v - dq)
    contact = np.abs(coming) > half
    spring = np.where(contact, stiffness * (twist - np.sign(coming) * half), 0.0)
    damper = np.where(contact, p["gear_damping"] + EXTRA_DAMPING * h * stiffness, 0.0)
    friction = p["coulomb"] + p["stribeck_torque"] / (1 + (v / STRIBECK_VELOCITY) ** 2)
    friction += p["load_friction"] * np.abs(spring + damper * (v - dq))
    decay = np.exp(-h / p["velocity_filter"])
    smoothing = 1 - (1 - decay) * p["velocity_filter"] / h

    def gear(mean):
        return spring + np.where(contact, 0.5 * h * stiffness, 0.0) * (mean - v) + damper * (mean - dq)

    def surplus(u):
        mean = 0.5 * (v + u)
        speed = filtered + smoothing * (mean - filtered)
        law = p["kp"] * (target - (r + 0.5 * h * (mean - v)) - p["encoder_zero"])
        law = np.clip(law - p["kp"] * p["kd_over_kp"] * speed, -p["torque_limit"], p["torque_limit"])
        return p["armature"] * (u - v) / h - law + p["viscous_damping"] * mean + gear(mean) + friction * np.sign(u)

    low, high = np.full_like(v, -300.0), np.full_like(v, 300.0)
    for _ in range(64):
        middle = 0.5 * (low + high)
        beyond = surplus(middle) > 0
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    u = 0.5 * (low + high)
    mean = 0.5 * (v + u)
    return u, gear(mean), contact, mean + decay * (filtered - mean)


@pytest.fixture(scope="module")
def motors(grey_network) -> LatentActuator:
    network: LatentNetwork = grey_network(spread=0.3, network=0.7, seed=1)
    copula = Copula(np.linalg.cholesky(0.7 * np.eye(3) + 0.3).T, (SCORES + 0.1 * SCORES**2)[:, None] * np.ones(3))
    return LatentActuator(replace(network, copula=copula), np.random.default_rng(2).standard_normal((MOTORS, 3)))


@pytest.fixture(scope="module")
def trial() -> Trial:
    """Commands that jump and pushes that change their sign, on loads from a shank to a standing robot."""
    rng, rows = np.random.default_rng(SEED), STEPS + 31
    target = np.repeat(rng.uniform(-0.4, 0.4, (rows // 20 + 1, MOTORS)), 20, axis=0)[:rows]
    push = 0.5 * np.sin(np.arange(rows)[:, None] * DT * rng.uniform(5, 40, MOTORS))
    return Trial(target, push, np.exp(rng.uniform(np.log(3e-4), np.log(3e-2), MOTORS)), DT)


def states(motors: LatentActuator):
    """Random rotors, joints and delayed targets: in and out of contact, at rest and moving."""
    rng = np.random.default_rng(3)
    values, n = motors.network.constants(motors.z), MOTORS
    moving = rng.integers(0, 2, n)
    names = ("q", "dq", *STATE, "target")
    scales = np.array([0.3, 4.0, 0.3, 4.0, 4.0, 4.0, 0.1, 0.3])
    drawn: dict[str, np.ndarray] = dict(zip(names, scales[:, None] * rng.standard_normal((8, n)), strict=True))
    drawn["rotor_pos"] = drawn["q"] + 0.02 * rng.standard_normal(n)
    for name in ("dq", "rotor_vel", "filtered", "joint_vel"):
        drawn[name] *= moving
    drawn["damping"] = np.abs(drawn["damping"])
    return values, drawn


def test_one_step_is_one_in_all_three_and_the_root_of_its_equation(motors):
    values, s = states(motors)
    state = MotorState(*(s[name] for name in STATE))
    after, expected, damping = step(
        step_constants(values, DT, np), state, s["target"], s["q"], s["dq"], DT, array_arithmetic(np)
    )
    vel = s["rotor_vel"] + DT * s["damping"] * (s["dq"] - s["joint_vel"]) / values["armature"]
    twist = s["rotor_pos"] - s["q"]
    root, gear, contact, filtered = rotor_velocity(
        values, s["target"], s["rotor_pos"], vel, s["filtered"], twist, s["dq"], DT
    )
    np.testing.assert_allclose(after.rotor_vel, root, atol=1e-9 * np.abs(root).max())
    np.testing.assert_allclose(after.filtered_vel, filtered, atol=1e-9 * np.abs(filtered).max())
    np.testing.assert_allclose(expected - damping * s["dq"], gear, atol=1e-9 * np.abs(gear).max())
    np.testing.assert_array_equal(damping > 0, contact)

    silent = LatentActuator(replace(motors.network, w3=np.zeros(8), b3=np.zeros(())), motors.z)
    arrays, torque = silent.arrays(DT), np.zeros(MOTORS)
    reset_actuator(arrays, s["target"], s["rotor_pos"].copy())
    rows = (ROTOR_VEL, "rotor_vel"), (FILTERED_VEL, "filtered"), (JOINT_VEL, "joint_vel"), (DAMPING, "damping")
    for row, name in rows:
        arrays.memory[1 + row] = s[name]
    step_actuator(arrays, DT, s["target"].copy(), s["q"].copy(), s["dq"].copy(), torque)
    np.testing.assert_allclose(arrays.memory[1 + TARGET], s["target"])  # no command has changed
    assert 0 < np.count_nonzero(arrays.damping) < MOTORS  # apart and touching

    constants = {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}
    floats = {name: jnp.asarray(value, jnp.float32) for name, value in s.items()}
    start = MotorState(*(floats[name] for name in STATE))
    moved, jax_torque, jax_damping = step(
        step_constants(constants, DT, jnp), start, floats["target"], floats["q"], floats["dq"], DT,
        array_arithmetic(jnp),
    )  # fmt: skip
    np.testing.assert_allclose(torque, expected, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(jax_torque, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(arrays.damping, damping, atol=1e-12)
    np.testing.assert_allclose(jax_damping, damping, atol=1e-6)
    for row, (in_numpy, in_jax) in enumerate(zip(after[:BASE_STATE], moved, strict=False)):
        np.testing.assert_allclose(arrays.memory[1 + row], in_numpy, atol=1e-12 * np.abs(in_numpy).max())
        np.testing.assert_allclose(in_jax, in_numpy, atol=1e-5 * np.abs(in_numpy).max())


def test_100_steps_in_closed_loop_are_one_motion_compiled_and_in_jax(motors, trial):
    response, net = run(motors, trial), motors.network
    preset = replace(
        PRESETS["rollout"], own_latents=False, taps=net.taps, num_latents=3, num_neurons=8, warm_up=30, window=STEPS + 1
    )
    assert preset.history + preset.window == len(trial.position_target)
    load = np.broadcast_to(trial.load_inertia, trial.position_target.shape)
    channels = (
        trial.position_target, response.joint_pos, response.joint_vel, response.joint_torque,
        trial.external_torque, load,
    )  # fmt: skip
    windows = jnp.asarray(complete(np.stack(channels, axis=-1).transpose(1, 0, 2)), jnp.float32)
    scales = {name: getattr(net, name) for name in ("error_scale", "velocity_scale", "torque_scale", "torque_limit")}
    rollout = objectives.closed_loop(preset, scales, bounded=False)
    position, velocity, torque = rollout(import_parameters(net), windows, jnp.asarray(motors.z, jnp.float32))
    assert position.shape == (STEPS, MOTORS)
    np.testing.assert_allclose(position, 0.0, atol=1e-5)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-5 * 3 * np.abs(response.joint_vel).max())
    np.testing.assert_allclose(torque, 0.0, atol=1e-5 * 3 * np.abs(response.joint_torque).max())


@pytest.mark.parametrize("terms", [("profile",), tuple(TERMS)], ids=len)
def test_one_step_of_a_servo_is_one_in_jax(grey_network, terms):
    rng, network = np.random.default_rng(7), grey_network(spread=0.3, terms=terms, asymmetry=0.2, dead_zone=0.02)
    z, seconds = rng.standard_normal((MOTORS, 3)), rng.uniform(0.0, 20.0, MOTORS)
    _, drawn = states(LatentActuator(network, z))
    supply, temperature_rise = rng.uniform(0.7, 1.3, MOTORS), rng.uniform(-30.0, 30.0, MOTORS)
    values = network.motor.decode(z, Conditions(network.warmth(z, seconds), supply, temperature_rise))
    drawn |= {"reference": drawn["target"] + 0.1, "reference_vel": rng.standard_normal(MOTORS)}
    drawn |= {name: 0.1 * rng.standard_normal(MOTORS) for name in ("integral", "current")}
    drawn["bristle"] = 0.005 * rng.uniform(-1.0, 1.0, MOTORS)
    names = (*STATE, "reference", "reference_vel", "integral", "current", "bristle")
    expected, torque, damping = step(
        step_constants(values, DT, np, terms), MotorState(*(drawn[name] for name in names)), drawn["target"],
        drawn["q"], drawn["dq"], DT, array_arithmetic(np), terms,
    )  # fmt: skip
    under = (jnp.asarray(each, jnp.float32) for each in (seconds, supply, temperature_rise))
    constants = objectives.decode(import_parameters(network), jnp.asarray(z, jnp.float32), False, terms, *under)
    for name, value in values.items():
        np.testing.assert_allclose(constants[name], value, rtol=1e-5, atol=1e-7, err_msg=name)
    floats = {name: jnp.asarray(value, jnp.float32) for name, value in drawn.items()}
    moved, jax_torque, jax_damping = step(
        step_constants(constants, DT, jnp, terms), MotorState(*(floats[name] for name in names)), floats["target"],
        floats["q"], floats["dq"], DT, array_arithmetic(jnp), terms,
    )  # fmt: skip
    np.testing.assert_allclose(jax_torque, torque, atol=2e-5 * np.abs(torque).max())
    np.testing.assert_allclose(jax_damping, damping, atol=1e-6)
    for name, one, other in zip(names, moved, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5 * max(np.abs(other).max(), 1e-2), err_msg=name)
