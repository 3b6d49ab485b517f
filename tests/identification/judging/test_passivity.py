"""The residual network of a grey box is bounded, and what it adds to a motor that is switched off is measured right."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.actuator.geared_motor import ROTOR_POS, ROTOR_VEL
from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.actuator.geared_motor_step import MotorState
from motorprior.actuator.grey_box import SCALES
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.servo_terms import TERMS
from motorprior.actuator.torque_law import reset_actuator, step_actuator
from motorprior.identification.judging.passivity import cycle_work, residual_bound, residual_work, switched_off

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


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10**6), load=st.floats(np.log(3e-4), np.log(3e-2)), speed=st.floats(-20.0, 20.0))
def test_a_joint_that_is_switched_off_is_not_driven_faster_than_friction_allows(grey_network, seed, load, speed):
    # without dry friction: viscous friction is what is left to stop a network of any weights
    viscous = 0.02
    free = {"coulomb": 0.0, "stribeck_torque": 0.0, "load_friction": 0.0, "viscous_damping": viscous}
    network = grey_network(spread=0.0, network=0.25, seed=seed, **free)
    motors, inertia = LatentActuator(network, Z), float(np.exp(load))
    arrays, torque, zero = switched_off(motors, DT), np.zeros(MOTORS), np.zeros(MOTORS)
    q, dq = np.zeros(MOTORS), np.full(MOTORS, speed)
    reset_actuator(arrays, zero, q)
    arrays.memory[1 + ROTOR_VEL] = speed
    rotor, stiffness, play = (
        arrays.parameters[SCALES + PARAMETERS.index(name)] for name in ("armature", "gear_stiffness", "backlash")
    )
    energies = []
    for _ in range(2500):
        step_actuator(arrays, DT, zero, q, dq, torque)
        dq = (dq + DT * torque / inertia) / (1.0 + DT * arrays.damping / inertia)
        q = q + DT * dq
        wound = np.maximum(np.abs(arrays.memory[1 + ROTOR_POS] - q) - play, 0.0)  # the row holds half the play
        energies.append(0.5 * (inertia * dq**2 + rotor * arrays.memory[1 + ROTOR_VEL] ** 2 + stiffness * wound**2))
    bound = residual_bound(network)
    start, driven = 0.5 * (inertia + rotor) * speed**2, 0.5 * (inertia + rotor) * (bound / viscous) ** 2
    # a crossing of the play gains bound·play at most, and the gear's spring holds what the network leans on it with
    assert np.all(np.max(energies, axis=0) <= 1.05 * np.maximum(start, driven) + 2 * bound * (2 * play) + bound**2)


def test_a_silent_network_adds_nothing_and_the_physics_take(grey_network):
    motors = LatentActuator(grey_network(), Z)
    work = cycle_work(motors, 0.3, 1.0)
    np.testing.assert_array_equal(work.network, 0.0)
    assert np.all(work.physics < 0.0) and residual_work(motors) == 0.0


def test_the_work_of_friction_over_a_cycle_in_closed_form(grey_network):
    dry = {"stribeck_torque": 0.0, "load_friction": 0.0, "viscous_damping": 0.0, "backlash": 0.0}
    motors = LatentActuator(grey_network(spread=0.0, coulomb=0.1, **dry), Z)
    # dry friction over a travel of four amplitudes; at the ends the gear gives way by coulomb/stiffness
    assert cycle_work(motors, 0.3, 0.5).physics == pytest.approx(-0.1 * 4 * (0.3 - 0.1 / 70.0), rel=0.02)


def test_a_network_that_pushes_along_is_found_out(grey_network):
    network: LatentNetwork = grey_network(spread=0.0)
    weak, strong = (LatentActuator(pushing(network, gain), Z) for gain in (0.02, 2.0))
    for motors in (weak, strong):
        work = cycle_work(motors, 0.3, 1.0)
        time = DT * np.arange(500)
        speed = 2 * np.pi * 0.3 * np.cos(2 * np.pi * time) / motors.network.velocity_scale
        first = speed / (1 + np.abs(speed))
        power = motors.network.w3[0] * motors.network.torque_scale * first / (1 + np.abs(first)) * speed
        np.testing.assert_allclose(work.network, DT * np.sum(power) * motors.network.velocity_scale, rtol=0.02)
    assert 0.0 < residual_work(weak) < 1.0 < residual_work(strong)


@pytest.mark.parametrize("terms", [("presliding",), ("asymmetry", "presliding"), tuple(TERMS)], ids=len)
def test_a_servo_that_is_switched_off_takes_energy_on_every_cycle(grey_network, terms):
    motors = LatentActuator(grey_network(spread=0.3, terms=terms, asymmetry=0.3), Z)
    for amplitude, frequency in ((0.02, 4.0), (0.1, 1.0), (0.6, 2.0)):
        assert np.all(cycle_work(motors, amplitude, frequency).physics < 1e-9)


@pytest.mark.parametrize("terms", [("presliding",), ("asymmetry", "presliding"), tuple(TERMS)], ids=len)
def test_a_servo_that_is_switched_off_swings_out(grey_network, terms):
    """Energy of rotor, joint, gear and bristle never grows by more than a step's share, and is gone in the end."""
    network = grey_network(spread=0.3, terms=terms, asymmetry=0.3, viscous_damping=1e-4)
    motors, inertia = LatentActuator(network, Z), 0.004
    arrays, values = switched_off(motors, DT), network.constants(Z)
    stiffness = arrays.parameters[SCALES + PARAMETERS.index("gear_stiffness")]
    q, dq, torque, zero = np.full(MOTORS, 0.0), np.full(MOTORS, 6.0), np.zeros(MOTORS), np.zeros(MOTORS)
    reset_actuator(arrays, zero, q)
    energies = []
    for _ in range(1500):
        step_actuator(arrays, DT, zero, q, dq, torque)
        dq = (dq + DT * torque / inertia) / (1.0 + DT * arrays.damping / inertia)
        q = q + DT * dq
        rotor, speed = arrays.memory[1 + ROTOR_POS], arrays.memory[1 + ROTOR_VEL]
        stretch = np.maximum(np.abs(rotor - q) - 0.5 * values["backlash"], 0.0)
        bristle = values["bristle_stiffness"] * arrays.memory[1 + MotorState._fields.index("bristle")] ** 2
        kinetic = values["armature"] * speed**2 + inertia * dq**2
        energies.append(0.5 * (kinetic + stiffness * stretch**2 + bristle))
    energy = np.array(energies)
    assert np.all(energy[1:] <= 1.05 * np.minimum.accumulate(energy, axis=0)[:-1] + 0.02 * energy[0])
    assert np.all(energy[-1] < 0.02 * energy[0])
