"""The compiled network is the reference formula, on the right inputs, at the right times."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import LatentNetwork, NetworkActuator

TAPS = (0, 2, 5)
PERIOD = 0.002


def network(neurons=8, latents=3, **changes):
    rng = np.random.default_rng(0)
    inputs = 2 * len(TAPS)
    net = LatentNetwork(
        w1=rng.standard_normal((inputs, neurons)),
        v1=rng.standard_normal((latents, neurons)),
        b1=rng.standard_normal(neurons),
        w2=rng.standard_normal((neurons, neurons)),
        b2=rng.standard_normal(neurons),
        w3=rng.standard_normal(neurons),
        b3=np.array(-0.3),
        log_armature=np.array(np.log(0.002)),
        armature_slope=rng.standard_normal(latents),
        taps=TAPS,
        period=PERIOD,
        error_scale=0.2,
        velocity_scale=3.0,
        torque_scale=0.7,
        torque_limit=10.0,
        has_armature=True,
    )
    return replace(net, **changes)


def motion(n, steps=40):
    """(3, steps, n) position_target, joint_pos, joint_vel."""
    return np.random.default_rng(1).normal(0.0, [[[0.3]], [[0.3]], [[4.0]]], (3, steps, n))


def torques(actuator, inputs, dt=PERIOD):
    arrays, out = actuator.arrays(dt), np.zeros(inputs.shape[1:])
    reset_actuator(arrays, inputs[0, 0].copy(), inputs[1, 0].copy())
    for step, row in enumerate(inputs.transpose(1, 0, 2).copy()):
        step_actuator(arrays, dt, row[0], row[1], row[2], out[step])
    return out


def scaled_history(net, inputs):
    """(steps, n, 2T) errors, then velocities, of the ages in TAPS; before the start: first error, at rest."""
    error = (inputs[0] - inputs[1]) / net.error_scale
    velocity = inputs[2] / net.velocity_scale
    rows = []
    for step in range(len(error)):
        past = [step - tap for tap in TAPS]
        rows.append([error[max(k, 0)] for k in past] + [velocity[k] if k >= 0 else 0 * velocity[0] for k in past])
    return np.array(rows).transpose(0, 2, 1)


@pytest.mark.parametrize(("n", "neurons"), [(1, 4), (17, 32)])
def test_compiled_network_equals_the_reference(n, neurons):
    net, inputs = network(neurons), motion(n)
    z = np.random.default_rng(2).standard_normal((n, 3))
    expected = np.array([net.torque(row, z) for row in scaled_history(net, inputs)])
    np.testing.assert_allclose(
        torques(NetworkActuator(net, z), inputs), expected, atol=1e-5 * net.torque_scale * neurons
    )
    assert np.ptp(expected) > net.torque_scale
