"""The torque of a residual network is bounded, and its work on a motor that is switched off is measured."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.optional_terms import TERMS
from motorprior.identification.evaluation.passivity import cycle_work, residual_bound, residual_work

MOTORS, DT = 8, 0.002
Z = np.random.default_rng(0).standard_normal((MOTORS, 3))


def pushing(network: LatentNetwork, gain: float) -> LatentNetwork:
    """Its network gives gain·softsign(softsign(velocity/scale)) [N·m]: it pushes along."""
    w1, w2, w3 = (np.zeros_like(weights) for weights in (network.w1, network.w2, network.w3))
    w1[len(network.taps), 0] = w2[0, 0] = 1.0
    w3[0] = gain / network.torque_scale
    return replace(network, w1=w1, w2=w2, w3=w3, v1=np.zeros_like(network.v1), b1=np.zeros_like(network.b1))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), weight=st.floats(0.01, 3.0), size=st.floats(0.1, 1e3))
def test_no_input_gives_a_torque_beyond_the_bound(grey_network, seed, weight, size):
    network = grey_network(network=weight, seed=seed)
    rng = np.random.default_rng(seed)
    inputs, z = size * rng.standard_normal((500, network.w1.shape[0])), rng.standard_normal((500, 3))
    assert np.abs(network.torque(inputs, z)).max() <= residual_bound(network) * (1 + 1e-12)
    # and it can be reached: with all of the second layer's neurons at their ends
    ends = replace(network, b2=1e6 * np.sign(network.w3), b3=np.abs(network.b3))
    assert ends.torque(inputs, z).max() == pytest.approx(residual_bound(network), rel=1e-3)


def test_the_work_of_friction_over_a_cycle_in_closed_form(grey_network):
    dry = {"stribeck_torque": 0.0, "load_friction": 0.0, "viscous_damping": 0.0, "backlash": 0.0}
    motors = LatentActuator(grey_network(spread=0.0, coulomb=0.1, **dry), Z)
    # dry friction over a travel of four amplitudes; at the ends the gear gives way by coulomb/stiffness
    assert cycle_work(motors, 0.3, 0.5)[1] == pytest.approx(-0.1 * 4 * (0.3 - 0.1 / 70.0), rel=0.02)


def test_the_work_of_a_network_that_pushes_in_the_direction_of_motion_in_closed_form(grey_network):
    network: LatentNetwork = grey_network(spread=0.0)
    weak, strong = (LatentActuator(pushing(network, gain), Z) for gain in (0.02, 2.0))
    for motors in (weak, strong):
        work, _ = cycle_work(motors, 0.3, 1.0)
        time = DT * np.arange(500)
        speed = 2 * np.pi * 0.3 * np.cos(2 * np.pi * time) / motors.network.velocity_scale
        first = speed / (1 + np.abs(speed))
        power = motors.network.w3[0] * motors.network.torque_scale * first / (1 + np.abs(first)) * speed
        np.testing.assert_allclose(work, DT * np.sum(power) * motors.network.velocity_scale, rtol=0.02)
    assert 0.0 < residual_work(weak) < 1.0 < residual_work(strong)


@pytest.mark.parametrize("terms", [("presliding",), ("asymmetry", "presliding"), tuple(TERMS)], ids=len)
def test_a_servo_that_is_switched_off_takes_energy_on_every_cycle(grey_network, terms):
    motors = LatentActuator(grey_network(spread=0.3, terms=terms, asymmetry=0.3), Z)
    for amplitude, frequency in ((0.02, 4.0), (0.1, 1.0), (0.6, 2.0)):
        assert np.all(cycle_work(motors, amplitude, frequency)[1] < 1e-9)
