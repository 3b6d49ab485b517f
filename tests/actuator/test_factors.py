"""Motors whose constants are multiplied are the motors that have those constants."""

from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Factors, with_factors
from motorprior.actuator.ideal_pd import IdealPd

DT = 0.001
ONE = np.ones(3)
FACTORS = Factors(
    kp=np.array([0.7, 1.0, 1.2]), kd=np.array([1.5, 1.0, 0.5]), torque_limit=np.array([0.5, 0.9, 1.1]),
    coulomb=np.array([0.0, 1.6, 1.0]),
)  # fmt: skip
WITHOUT_FRICTION = FACTORS._replace(coulomb=ONE)


def same_parameters(one, other):
    first, second = one.arrays(DT), other.arrays(DT)
    np.testing.assert_allclose(first.parameters, second.parameters, rtol=1e-12)
    np.testing.assert_allclose(first.damping, second.damping, rtol=1e-12)
    np.testing.assert_allclose(one.damping, other.damping, rtol=1e-12)


def pd(factors):
    return IdealPd(9.0 * factors.kp, 0.8 * factors.kd, 1.3 * factors.torque_limit, np.full(3, 0.003), np.full(3, 0.01))


def test_of_a_pd_with_and_without_friction():
    one = pd(Factors(ONE, ONE, ONE, ONE))
    same_parameters(with_factors(one, WITHOUT_FRICTION), pd(FACTORS))
    rough = replace(pd(FACTORS), coulomb=0.1 * FACTORS.coulomb)
    same_parameters(with_factors(replace(one, coulomb=0.1 * ONE), FACTORS), rough)
