"""The compiled latent network, sixteen motors side by side, is the one that was trained in JAX."""

import jax.numpy as jnp
import numpy as np
import pytest

from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import NetworkActuator, scaled_torque
from motorprior.identification.networks.objectives import export, initial_parameters, motor_bias
from motorprior.identification.presets import PRESETS

SCALES = {"error_scale": 0.15, "velocity_scale": 3.0, "torque_scale": 0.7, "torque_limit": 50.0}


@pytest.fixture(params=["paper", "rollout", "one_network"])
def case(request):
    """Preset, random parameters with no zero among them, scaled inputs (B, 2T), z (B, Z)."""
    preset, rng = PRESETS[request.param], np.random.default_rng(0)
    parameters = initial_parameters(rng, preset)
    for name in ("b1", "b2", "b3", "armature_slope"):
        parameters[name] = jnp.asarray(0.5 * rng.standard_normal(parameters[name].shape), jnp.float32)
    parameters["w3"] = jnp.asarray(rng.standard_normal(preset.num_neurons) / np.sqrt(preset.num_neurons), jnp.float32)
    inputs = rng.normal(0.0, 1.5, (19, 2 * len(preset.taps))).astype(np.float32)
    return preset, parameters, inputs, rng.standard_normal((19, preset.num_latents)).astype(np.float32)


def test_compiled_equals_jax(case):
    preset, parameters, inputs, z = case
    net = export(parameters, preset, SCALES)
    # each motor's history holds its own inputs, oldest first; what lies between two taps is not seen
    history = np.full((2, preset.taps[-1] + 1, len(z)), 9.0)
    taps = np.array(preset.taps)
    history[0, preset.taps[-1] - taps] = inputs[:, : len(taps)].T * net.error_scale
    history[1, preset.taps[-1] - taps] = inputs[:, len(taps) :].T * net.velocity_scale
    arrays, torque = NetworkActuator(net, z.astype(float)).arrays(net.period), np.zeros(len(z))
    reset_actuator(arrays, np.zeros(len(z)), np.zeros(len(z)))
    for error, velocity in history.transpose(1, 0, 2).copy():
        step_actuator(arrays, net.period, error, np.zeros(len(z)), velocity, torque)
    jax_torque = 0.7 * scaled_torque(parameters, jnp.asarray(inputs), motor_bias(parameters, jnp.asarray(z)))
    np.testing.assert_allclose(torque, jax_torque, atol=1e-5 * 0.7)
    assert (np.std(jax_torque) > 0.05) == (preset.num_neurons > 0)
