"""Motors whose gains vary are the motors that have those gains."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.actuator import with_gain_factors
from motorprior.actuator.friction_pd import FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.latent import LatentActuator
from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError

DT = 0.001
KP, KD = np.array([0.7, 1.0, 1.2]), np.array([1.5, 1.0, 0.5])


def same_parameters(one, other):
    first, second = one.arrays(DT), other.arrays(DT)
    np.testing.assert_allclose(first.parameters, second.parameters, rtol=1e-12)
    np.testing.assert_allclose(first.damping, second.damping, rtol=1e-12)
    np.testing.assert_allclose(one.damping, other.damping, rtol=1e-12)


def pd(kp, kd):
    return IdealPd(9.0 * kp, 0.8 * kd, np.full(3, 1.3), np.full(3, 0.003), np.full(3, 0.01))


def test_of_a_pd_with_and_without_friction():
    one, friction = np.ones(3), np.full(3, 0.1)
    same_parameters(with_gain_factors(pd(one, one), KP, KD), pd(KP, KD))
    same_parameters(with_gain_factors(FrictionPd(pd(one, one), friction), KP, KD), FrictionPd(pd(KP, KD), friction))


@pytest.mark.parametrize("fleet", ["pupper_v2", "foreign_direct", "foreign_servo"])
def test_of_true_motors(fleet):
    motors = load_fleet(fleet).center(3)
    other = replace(motors, kp=motors.kp * KP, kd=motors.kd * KD)
    same_parameters(with_gain_factors(motors.actuator(), KP, KD), other.actuator())
    assert np.abs(other.actuator().arrays(DT).parameters - motors.actuator().arrays(DT).parameters).max() > 0.0


@pytest.mark.parametrize("stated", [None, np.array([[9.0] * 3, [0.8] * 3])])
def test_of_a_grey_box(grey_network, stated):
    of_own = grey_network(kp=2.0, kd_over_kp=0.1, spread=0.0)
    latents = np.zeros((3, of_own.num_latents))
    net = of_own if stated is None else replace(of_own, gain_unit="N·m/rad")
    varied = with_gain_factors(LatentActuator(net, latents, gains=stated), KP, KD)
    for motor in range(3):
        kp, kd = np.array([KP[motor], KD[motor]]) * (1.0 if stated is None else stated[:, motor])
        told = grey_network(kp=2.0 * kp, kd_over_kp=0.1 * kd / kp, spread=0.0)
        np.testing.assert_allclose(
            varied.arrays(DT).parameters[:, motor], LatentActuator(told, latents).arrays(DT).parameters[:, motor],
            rtol=1e-9,
        )  # fmt: skip


def test_motors_without_gains_are_refused_unless_no_gain_varies(grey_network):
    network = replace(grey_network(network=0.1), motor=None)
    actuator = LatentActuator(network, np.zeros((3, network.num_latents)))
    assert with_gain_factors(actuator, np.ones(3), np.ones(3)) is actuator
    with pytest.raises(ConfigError, match=r"'latent' .* have no gains .* leave the ranges of kp and kd"):
        with_gain_factors(actuator, KP, KD)


def test_factors_are_no_stated_gains(grey_network):
    net = replace(grey_network(kp=2.0, kd_over_kp=0.1, spread=0.0), gain_unit="N·m/rad")
    with pytest.raises(ConfigError, match=r"stated gains \[N·m/rad\] -> say which"):
        with_gain_factors(LatentActuator(net, np.zeros((3, net.num_latents))), KP, KD)
