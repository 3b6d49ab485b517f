"""What a motor's log says of its limits of speed, whatever drives the joint besides."""

import numpy as np

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of
from motorprior.identification.physics.speed_limits import MARGIN, held_speed, least_outputs

PERIOD, ROWS = 0.002, 500


def test_a_speed_is_held_if_it_lasts_and_leads_to_the_target():
    vel, error = np.zeros((5, ROWS)), np.full((5, ROWS), 0.1)
    vel[:, 100:400] = 0.4
    vel[1, 200:230] = 5.0  # an impact: 60 ms
    vel[2, 200:260] = -2.0  # 120 ms, but away from the target
    vel[3], error[3] = -vel[3], -error[3]
    vel[4, 300:420] = 0.7
    vel[4, 360] = 0.65
    np.testing.assert_allclose(held_speed(vel, error, PERIOD), [0.4, 0.4, 0.4, 0.4, 0.7], rtol=1e-6)


def test_a_log_shorter_than_that_holds_nothing():
    np.testing.assert_array_equal(held_speed(np.ones((2, 20)), np.ones((2, 20)), PERIOD), 0.0)


def test_bounds_are_of_limits_of_speed_alone_and_within_reach():
    terms = ("profile", "torque_speed")
    names, center = parameters_of(terms), np.zeros(len(parameters_of(terms)))
    held = {"profile_speed": np.array([0.0, 0.5, 1e3]), "no_load_speed": np.array([0.0, 0.25, 1e3])}
    least = least_outputs(center, terms, held)
    for row, name in enumerate(names):
        bounds = [-np.inf, np.log(MARGIN * held[name][1]), LOG_REACH] if name in held else -np.inf
        np.testing.assert_allclose(least[:, row], bounds)
