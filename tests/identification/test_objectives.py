"""The losses are zero where they must be, and what is written where they are not."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.network import Parameters, export, initial_parameters
from motorprior.identification.objectives import (
    POSITION_SCALE,
    VELOCITY_SCALE,
    kl_to_standard_normal,
    rollout_loss,
    torque_loss,
)
from motorprior.identification.presets import PRESETS

TAPS = (0, 1, 3)
ROLLOUT = replace(PRESETS["rollout"], taps=TAPS, num_neurons=8, num_latents=2, window=40)
TORQUE = replace(PRESETS["paper"], taps=TAPS, num_neurons=8, num_latents=2)
SCALES = {"error_scale": 0.2, "velocity_scale": 3.0, "torque_scale": 0.7, "torque_limit": 0.08}
MOTORS = 3
Z = np.array([[0.5, -1.0], [0.0, 0.3], [-1.2, 0.8]])


def parameters() -> Parameters:
    rng = np.random.default_rng(0)
    given = initial_parameters(rng, ROLLOUT)
    # a motor, roughly: torque falls with the velocity; armature differs by motor
    given["armature_slope"] = jnp.asarray([0.3, -0.2])
    return given | {"b1": jnp.asarray(0.1 * rng.standard_normal(8), jnp.float32)}


def recorded(given: Parameters):
    """(MOTORS, rows, 6) log of the very motors that ``given`` describes, on a dynamometer."""
    rng, steps = np.random.default_rng(1), TAPS[-1] + ROLLOUT.window
    trial = Trial(
        np.cumsum(rng.normal(0.0, 0.05, (steps, MOTORS)), axis=0),
        rng.normal(0.0, 0.5, (steps, MOTORS)),
        np.array([0.001, 0.004, 0.02]),
        ROLLOUT.period,
    )
    response = run(LatentActuator(export(given, ROLLOUT, SCALES), Z), trial)
    load = np.broadcast_to(trial.load_inertia, trial.position_target.shape)
    channels = (
        trial.position_target, response.joint_pos, response.joint_vel, response.joint_torque,
        trial.external_torque, load,
    )  # fmt: skip
    return np.stack(channels, axis=-1).transpose(1, 0, 2)


def loss(objective, given: Parameters, windows, preset=ROLLOUT) -> float:
    value = objective(preset, SCALES)(given, jnp.asarray(windows, jnp.float32), jnp.asarray(Z, jnp.float32))
    return float(value)


def test_a_perfect_model_rolls_out_its_own_recording():
    given = parameters()
    windows = recorded(given)
    # float32 against float64 over 40 steps: 1e-6 rad of 0.01, 1e-4 rad/s of 0.3; squared, halved: below 1e-6
    assert loss(rollout_loss, given, windows) < 1e-6
    assert np.max(np.abs(windows[..., 3])) == pytest.approx(0.08)  # the limit is reached, and so is its clip


@pytest.mark.parametrize(
    ("name", "change"), [("log_armature", 0.1), ("b3", 0.05), ("armature_slope", 0.1), ("w1", 0.02), ("v1", 0.02)]
)
def test_an_imperfect_model_pays(name, change):
    given = parameters()
    windows = recorded(given)
    assert loss(rollout_loss, given | {name: given[name] + change}, windows) > 1e-4


def test_a_rollout_never_looks_at_the_torque_channel():
    given = parameters()
    windows = recorded(given)
    windows[..., 3] = 7.0
    assert loss(rollout_loss, given, windows) < 1e-6


def limp() -> Parameters:
    given = parameters()
    return given | {"w3": 0 * given["w3"], "b3": jnp.asarray(0.0)}


def test_a_limp_motor_is_a_double_integrator():
    # no torque, 0.002 kg·m² of armature and 0.008 of load, constant 0.1 N·m: a = 10 rad/s²
    given = limp() | {"armature_slope": jnp.zeros(2)}
    steps = np.arange(TAPS[-1] + ROLLOUT.window) - TAPS[-1]  # free from row TAPS[-1] on
    velocity = 10.0 * 0.002 * steps
    position = 10.0 * 0.002**2 * steps * (steps + 1) / 2
    rows = [0 * steps, position, velocity, 0 * steps, 0 * steps + 0.1, 0 * steps + 0.008]
    windows = np.stack(rows, axis=-1)[None].repeat(MOTORS, axis=0)
    assert loss(rollout_loss, given, windows) < 1e-8
    # all recorded positions after the start are off by one POSITION_SCALE, velocities by two VELOCITY_SCALE
    windows[:, TAPS[-1] + 1 :, 1] += POSITION_SCALE
    windows[:, TAPS[-1] + 1 :, 2] += 2 * VELOCITY_SCALE
    expected = (np.sqrt(2.0) - 1) + (np.sqrt(5.0) - 1)
    assert loss(rollout_loss, given, windows) == pytest.approx(expected, rel=1e-5)


def test_torque_regression_is_the_mean_square_of_the_newest_row():
    given = parameters()
    rows = np.random.default_rng(2).normal(0.0, 0.4, (MOTORS, TAPS[-1] + 1, 6))
    net = replace(export(given, TORQUE, SCALES), torque_limit=1e9)
    past = rows[:, [TAPS[-1] - tap for tap in TAPS]]
    inputs = np.concatenate([(past[..., 0] - past[..., 1]) / 0.2, past[..., 2] / 3.0], axis=1)
    rows[:, -1, 3] = net.torque(inputs, Z)
    assert loss(torque_loss, given, rows, TORQUE) < 1e-10
    rows[:, -1, 3] += 0.7 * np.array([1.0, -2.0, 3.0])  # in units of torque_scale: (1 + 4 + 9) / 3
    assert loss(torque_loss, given, rows, TORQUE) == pytest.approx(14 / 3, rel=1e-5)
    rows[:, :-1, 3] = 99.0  # older torques do not count
    assert loss(torque_loss, given, rows, TORQUE) == pytest.approx(14 / 3, rel=1e-5)


def test_divergence_from_the_standard_normal():
    # N(0, I): 0. mean 2 in one of two dimensions: ½·4 = 2. variance e: ½·(e - 1 - 1)
    mean = jnp.array([[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]])
    log_var = jnp.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    expected = [0.0, 2.0, 0.5 * (np.e - 2.0)]
    np.testing.assert_allclose(kl_to_standard_normal(mean, log_var), expected, rtol=1e-6, atol=1e-7)


def test_divergence_is_the_mean_log_ratio_of_samples():
    mean, log_var = np.array([0.7, -0.4]), np.array([-1.0, 0.5])
    z = mean + np.exp(0.5 * log_var) * np.random.default_rng(0).standard_normal((400_000, 2))
    ratio = 0.5 * (z**2 - (z - mean) ** 2 / np.exp(log_var) - log_var).sum(axis=1)
    # its standard error is about 1/sqrt(400000) = 0.002
    assert float(kl_to_standard_normal(jnp.asarray(mean), jnp.asarray(log_var))) == pytest.approx(
        ratio.mean(), abs=0.01
    )
