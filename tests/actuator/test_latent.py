"""The compiled network is the reference formula, on the right inputs, at the right times."""

import numpy as np
import pytest
from imposed_motion import torques
from networks import network

from motorprior.actuator.latent import NetworkActuator

TAPS = (0, 2, 5)


def motion(n, steps=40):
    """(3, steps, n) position_target, joint_pos, joint_vel."""
    return np.random.default_rng(1).normal(0.0, [[[0.3]], [[0.3]], [[4.0]]], (3, steps, n))


def scaled_history(net, inputs):
    """(steps, n, 2T) errors and then velocities at the ages in TAPS.

    Before the start, errors equal the first one and velocities are zero.
    """
    error = (inputs[0] - inputs[1]) / net.error_scale
    velocity = inputs[2] / net.velocity_scale
    rows = []

    for step in range(len(error)):
        past = [step - tap for tap in TAPS]
        errors = [error[max(index, 0)] for index in past]
        velocities = [
            velocity[index] if index >= 0 else np.zeros_like(velocity[0]) for index in past
        ]
        rows.append(errors + velocities)

    return np.array(rows).transpose(0, 2, 1)


@pytest.mark.parametrize(("n", "neurons"), [(1, 4), (17, 32)])
def test_compiled_network_equals_the_reference(n, neurons):
    net = network(neurons, taps=TAPS)
    inputs = motion(n)
    z = np.random.default_rng(2).standard_normal((n, 3))
    expected = np.array([net.torque(row, z) for row in scaled_history(net, inputs)])
    compiled = torques(NetworkActuator(net, z), inputs)

    np.testing.assert_allclose(compiled, expected, atol=1e-5 * net.torque_scale * neurons)
    assert np.ptp(expected) > net.torque_scale
