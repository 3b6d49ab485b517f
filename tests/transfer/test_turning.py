"""Speed and yaw rate of walks whose path is known: a circle."""

import numpy as np
import pytest

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rollout import Episode
from turning import COMMANDS, HOLD, commands_of, followed, rows_of, told

STEPS, SPEED, RATE = 800, 0.3, 0.6


def circle(steps: int = STEPS, fault: int = 0, off: float = 0.0) -> Episode:
    """To the left, more than half of a turn, so that the heading passes π."""
    time = PUPPER_V2.control_dt * np.arange(steps)
    trace, yaw = np.zeros((steps, 19)), RATE * time
    trace[:, 0], trace[:, 1] = SPEED / RATE * np.sin(yaw), SPEED / RATE * (1.0 - np.cos(yaw))
    trace[:, 3], trace[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    nothing = np.zeros(1)
    return Episode(0.0, steps, off, np.zeros(2), fault, 1, nothing, nothing, trace, nothing)


def test_a_circle_has_its_speed_and_its_yaw_rate():
    found = followed(PUPPER_V2, [circle(), circle()], STEPS)
    assert found["upright"] == 1.0
    assert found["speed"] == pytest.approx(SPEED, rel=1e-3) and found["yaw_rate"] == pytest.approx(RATE, rel=1e-6)


def test_only_walks_without_a_fall_are_measured():
    found = followed(PUPPER_V2, [circle(off=0.1), circle(300, off=9.0), circle(fault=1), circle(off=0.3)], STEPS)
    assert found["speed_off"] == pytest.approx(0.2)
    assert found["upright"] == 0.5 and found["yaw_rate"] == pytest.approx(RATE, rel=1e-6)
    assert followed(PUPPER_V2, [circle(50)], STEPS) == {"upright": 0.0}


def test_commands_are_shares_of_what_the_robot_is_built_for():
    told = commands_of(PUPPER_V2)
    assert len(told) == len(COMMANDS) and told[0] == pytest.approx((0.3, 0.6)) and told[4] == pytest.approx((-0.2, 0.0))


def test_the_fastest_straight_on_and_stop_and_go_are_among_what_is_told():
    found = told(PUPPER_V2, 20.0)
    fastest = found["told 0.5 m/s 0 rad/s"].schedule(PUPPER_V2, 0, 2000)
    assert (fastest == (0.5, 0.0)).all() and len(found) == len(COMMANDS) + 2
    each = round(HOLD / PUPPER_V2.control_dt)
    for name, speeds in (("0.4, 0", [0.4, 0.0]), ("0.5, 0, -0.2", [0.5, 0.0, -0.2])):
        schedule = found[f"told {name} m/s in turn"].schedule(PUPPER_V2, 7, 2000)
        wanted = np.repeat((10 * speeds)[:10], each)
        np.testing.assert_allclose(schedule, np.stack([wanted, 0.0 * wanted], axis=1), atol=1e-12)


def test_a_schedule_has_rows_of_its_own_beside_those_of_steady_commands():
    rows = list(rows_of("twin", "told 0.4, 0 m/s in turn", 3, followed(PUPPER_V2, [circle(off=0.1)], STEPS)))
    assert {(row.motors, row.part, row.seed) for row in rows} == {("twin", "told 0.4, 0 m/s in turn", 3)}
    measures = {row.quantity: (row.value, row.unit) for row in rows}
    assert measures["commanded/upright"] == (1.0, "1") and measures["commanded/speed_off"] == (0.1, "m/s")
