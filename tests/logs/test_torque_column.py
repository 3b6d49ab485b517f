"""A torque column is compared with the known load of its joint."""

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.logs.motor_log import MotorLog
from motorprior.logs.torque_column import torque_column

PERIOD = 0.005
INERTIA = 0.05


def log_with_torque(factor: float, rotor: float, friction: float, late_rows: int) -> MotorLog:
    """Pendulum in sines, with a torque in front of a rotor and its friction."""
    time = PERIOD * np.arange(4000)
    angle = 0.5 * np.sin(2.0 * time) + 0.3 * np.sin(7.3 * time + 1.0)
    speed = 1.0 * np.cos(2.0 * time) + 2.19 * np.cos(7.3 * time + 1.0)
    acceleration = -2.0 * np.sin(2.0 * time) - 15.987 * np.sin(7.3 * time + 1.0)
    external = -1.5 * np.sin(angle)
    torque = (INERTIA + rotor) * acceleration - external + friction * np.sign(speed)
    column = factor * np.roll(torque, late_rows)
    return log_of(
        time,
        angle,
        angle,
        load_inertia=np.full((4000, 1), INERTIA),
        external_torque=external[:, None],
        joint_torque=column[:, None],
    )


@pytest.mark.parametrize(
    ("factor", "rotor", "friction", "late_rows"),
    [(1.0, 0.0, 0.0, 0), (1.4, 0.02, 0.25, 0), (0.111, 0.02, 0.0, 0), (-1.96, 0.0, 0.1, 3)],
)
def test_factor_rotor_friction_and_lag_are_recovered(
    factor: float, rotor: float, friction: float, late_rows: int
):
    column = torque_column(log_with_torque(factor, rotor, friction, late_rows), 0)

    assert column is not None
    assert column.factor == pytest.approx(factor, rel=0.03)
    assert column.rotor_inertia == pytest.approx(rotor, abs=2e-3)
    assert column.friction == pytest.approx(friction, abs=0.03)
    assert column.lag == pytest.approx(late_rows * PERIOD, abs=1e-9)


def test_a_column_without_a_known_load_is_not_judged():
    time = PERIOD * np.arange(400)
    log = log_of(time, np.sin(time), joint_torque=np.ones((400, 1)))

    assert torque_column(log, 0) is None
