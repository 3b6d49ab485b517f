"""What a motor's log says of its limits of speed, whatever drives the joint besides."""

import numpy as np

from motorprior.identification.physics.window_runs import held_speed

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
