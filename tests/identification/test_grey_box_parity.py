"""The grey box in JAX, compiled, and in plain numpy is one motor: for a step, and for 100 steps of a closed loop.

The numpy motor does not share the other two's algebra: it finds the rotor's velocity as the root of its equation of
motion by bisection. Where a gear touches or a rotor sticks, a decision within rounding could fall either way in
float32; the seeds are such that none does.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor import DAMPING, FILTERED_VEL, JOINT_VEL, ROTOR_POS, ROTOR_VEL, TARGET
from motorprior.actuator.geared_motor_step import EXTRA_DAMPING, RESOLVED, STRIBECK_VELOCITY
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.torque_law import reset_actuator, step_actuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification import motor_dynamics
from motorprior.identification.closed_loop import closed_loop
from motorprior.identification.network import import_parameters
from motorprior.identification.presets import PRESETS

MOTORS, STEPS, DT = 24, 100, 0.002
SEED = 4


def rotor_velocity(p, target, r, v, filtered, twist, dq, h):
    """The root v' of armature·(v' - v)/h = law - viscous·v̄ - gear - friction·sign(v'); gear, contact and filter."""
    half, stiffness = 0.5 * p["backlash"], np.minimum(p["gear_stiffness"], RESOLVED * p["armature"] / h**2)
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


class NumpyMotor:
    """One step after another, as the docstring of `geared_motor` has it."""

    def __init__(self, values, joint_pos, target):
        self.p, n = values, len(joint_pos)
        self.rotor_pos, self.rotor_vel, self.filtered = joint_pos.copy(), np.zeros(n), np.zeros(n)
        self.joint_vel, self.damping = np.zeros(n), np.zeros(n)
        self.commands = [target] * 24

    def step(self, target, q, dq):
        self.commands.insert(0, target)
        ages, past = self.p["delay"] / DT + 0.5, np.array(self.commands[:24])
        wanted = np.array([np.interp(age, np.arange(24), past[:, i]) for i, age in enumerate(ages)])
        return self.advance(wanted, q, dq)

    def advance(self, wanted, q, dq):
        """(torque, damping) for a step towards delayed targets."""
        self.rotor_vel = self.rotor_vel + DT * self.damping * (dq - self.joint_vel) / self.p["armature"]
        self.joint_vel, twist = dq, self.rotor_pos - q
        found = rotor_velocity(self.p, wanted, self.rotor_pos, self.rotor_vel, self.filtered, twist, dq, DT)
        self.rotor_vel, gear, contact, self.filtered = found
        self.rotor_pos = self.rotor_pos + DT * self.rotor_vel
        stiffness = np.minimum(self.p["gear_stiffness"], RESOLVED * self.p["armature"] / DT**2)
        self.damping = contact * (self.p["gear_damping"] + DT * stiffness) / 2
        return gear + self.damping * dq, self.damping


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
    names = ("q", "dq", "rotor_pos", "rotor_vel", "filtered", "joint_vel", "damping", "target")
    scales = np.array([0.3, 4.0, 0.3, 4.0, 4.0, 4.0, 0.1, 0.3])
    drawn: dict[str, np.ndarray] = dict(zip(names, scales[:, None] * rng.standard_normal((8, n)), strict=True))
    drawn["rotor_pos"] = drawn["q"] + 0.02 * rng.standard_normal(n)
    for name in ("dq", "rotor_vel", "filtered", "joint_vel"):
        drawn[name] *= moving
    drawn["damping"] = np.abs(drawn["damping"])
    return values, drawn


def test_one_step_is_one_in_all_three(motors):
    values, s = states(motors)
    plain = NumpyMotor(values, s["rotor_pos"], s["target"])
    plain.rotor_vel, plain.filtered, plain.joint_vel, plain.damping = (
        s["rotor_vel"], s["filtered"], s["joint_vel"], s["damping"],
    )  # fmt: skip
    expected, damping = plain.advance(s["target"], s["q"], s["dq"])

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
    state = motor_dynamics.MotorState(
        *(floats[name] for name in ("rotor_pos", "rotor_vel", "filtered", "joint_vel", "damping"))
    )
    state, jax_torque, jax_damping = motor_dynamics.advance(
        constants, state, floats["target"], floats["q"], floats["dq"], DT
    )
    for found in (torque, jax_torque):
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    for found in (arrays.damping, jax_damping):
        np.testing.assert_allclose(found, damping, atol=1e-6)
    for row, name in ((ROTOR_POS, "rotor_pos"), (ROTOR_VEL, "rotor_vel"), (FILTERED_VEL, "filtered")):
        for found in (arrays.memory[1 + row], getattr(state, name.replace("filtered", "filtered_vel"))):
            np.testing.assert_allclose(found, getattr(plain, name), atol=1e-5 * np.abs(getattr(plain, name)).max())


def in_numpy(motors: LatentActuator, trial: Trial):
    """(steps, n) joint_pos, joint_vel and joint_torque of the dynamometer."""
    net, targets = motors.network, trial.position_target
    q, dq = targets[0].copy(), np.zeros(MOTORS)
    motor, out = NumpyMotor(net.constants(motors.z), q, targets[0]), []
    errors, speeds = [0 * q] * (net.taps[-1] + 1), [0 * q] * (net.taps[-1] + 1)
    for target, push in zip(targets, trial.external_torque, strict=True):
        errors, speeds = [(target - q) / net.error_scale, *errors], [dq / net.velocity_scale, *speeds]
        inputs = np.stack([errors[tap] for tap in net.taps] + [speeds[tap] for tap in net.taps], axis=1)
        gear, damping = motor.step(target, q, dq)
        torque = gear + net.torque(inputs, motors.z)
        after = (dq + DT * (torque + push) / trial.load_inertia) / (1 + DT * damping / trial.load_inertia)
        out.append((q, dq, torque - damping * after))
        dq = after
        q = q + DT * dq
    return np.array(out).transpose(1, 0, 2)


def test_100_steps_in_closed_loop_are_one_motion_compiled_and_in_numpy(motors, trial):
    response, (q, dq, torque) = run(motors, trial), in_numpy(motors, trial)
    assert np.ptp(q, axis=0).min() > 0.1
    np.testing.assert_allclose(response.joint_pos, q, atol=1e-5)
    np.testing.assert_allclose(response.joint_vel, dq, atol=1e-5 * np.abs(dq).max())
    np.testing.assert_allclose(response.joint_torque, torque, atol=1e-5 * np.abs(torque).max())


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
    windows = jnp.asarray(np.stack(channels, axis=-1).transpose(1, 0, 2), jnp.float32)
    scales = {name: getattr(net, name) for name in ("error_scale", "velocity_scale", "torque_scale", "torque_limit")}
    rollout = closed_loop(preset, scales, bounded=False)
    position, velocity, torque = rollout(import_parameters(net), windows, jnp.asarray(motors.z, jnp.float32))
    assert position.shape == (STEPS, MOTORS)
    np.testing.assert_allclose(position, 0.0, atol=1e-5)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-5 * 3 * np.abs(response.joint_vel).max())
    np.testing.assert_allclose(torque, 0.0, atol=1e-5 * 3 * np.abs(response.joint_torque).max())
