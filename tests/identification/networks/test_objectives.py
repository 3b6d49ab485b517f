"""Losses of networks are zero for a perfect model, and equal their formulas otherwise."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from series import complete

from motorprior.actuator.latent import NetworkActuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.networks.objectives import (
    Parameters,
    initial_parameters,
    latent_network,
    objective_of,
)
from motorprior.identification.presets import PRESETS

TAPS = (0, 1, 3)
NETWORK = replace(PRESETS["latent_network"], taps=TAPS, num_neurons=8, num_latents=2, window=40)
TORQUE = replace(PRESETS["paper"], taps=TAPS, num_neurons=8, num_latents=2)
SCALES = {"error_scale": 0.2, "velocity_scale": 3.0, "torque_scale": 0.7, "torque_limit": 0.08}
MOTORS = 3
Z = np.array([[0.5, -1.0], [0.0, 0.3], [-1.2, 0.8]])


def parameters(preset=NETWORK) -> Parameters:
    rng = np.random.default_rng(0)
    values = initial_parameters(rng, preset)
    # roughly a motor: torque falls with the velocity; the armature differs between motors
    values["armature_slope"] = jnp.asarray([0.3, -0.2])
    readout = jnp.asarray(rng.standard_normal(8) / np.sqrt(8), jnp.float32)

    return values | {"b1": jnp.asarray(0.1 * rng.standard_normal(8), jnp.float32), "w3": readout}


def recorded(values: Parameters, preset=NETWORK):
    """(MOTORS, rows, 6) log of motors with these parameters of the network, on a dynamometer."""
    rng = np.random.default_rng(1)
    steps = preset.history + preset.window
    trial = Trial(
        np.cumsum(rng.normal(0.0, 0.05, (steps, MOTORS)), axis=0),
        rng.normal(0.0, 0.5, (steps, MOTORS)),
        np.array([0.001, 0.004, 0.02]),
        preset.period,
    )
    response = run(NetworkActuator(latent_network(values, preset, SCALES), Z), trial)
    load = np.broadcast_to(trial.load_inertia, trial.position_target.shape)
    channels = (
        trial.position_target,
        response.joint_pos,
        response.joint_vel,
        response.joint_torque,
        trial.external_torque,
        load,
    )

    return complete(np.stack(channels, axis=-1).transpose(1, 0, 2))


@cache
def compiled(preset, has_torque: bool):
    return jax.jit(objective_of(preset, SCALES, has_torque).loss)


def loss(values: Parameters, windows, preset=NETWORK, has_torque=False) -> float:
    made = compiled(preset, has_torque)
    return float(made(values, jnp.asarray(windows, jnp.float32), jnp.asarray(Z, jnp.float32)))


@pytest.mark.parametrize("has_torque", [False, True])
def test_a_perfect_model_rolls_out_its_own_recording(has_torque):
    values = parameters()
    windows = recorded(values)

    # float32 differs from float64 over 40 steps by 1e-6 rad of 0.01 rad and by 1e-4 rad/s of
    # 0.3 rad/s; squared and halved, this is below 1e-6
    assert loss(values, windows, has_torque=has_torque) < 1e-6
    # the torque limit is reached, so that clipping is tested
    assert np.max(np.abs(windows[..., 3])) == pytest.approx(0.08)


def test_torque_regression_is_the_mean_square_of_the_newest_row():
    values = parameters()
    rows = np.random.default_rng(2).normal(0.0, 0.4, (MOTORS, TAPS[-1] + 1, 6))
    net = replace(latent_network(values, TORQUE, SCALES), torque_limit=1e9)
    past = rows[:, [TAPS[-1] - tap for tap in TAPS]]
    inputs = np.concatenate([(past[..., 0] - past[..., 1]) / 0.2, past[..., 2] / 3.0], axis=1)
    rows[:, -1, 3] = net.torque(inputs, Z)

    assert loss(values, rows, TORQUE) < 1e-10

    rows[:, -1, 3] += 0.7 * np.array([1.0, -2.0, 3.0])  # in units of torque_scale: (1 + 4 + 9) / 3

    assert loss(values, rows, TORQUE) == pytest.approx(14 / 3, rel=1e-5)

    rows[:, :-1, 3] = 99.0  # older torques do not count

    assert loss(values, rows, TORQUE) == pytest.approx(14 / 3, rel=1e-5)
