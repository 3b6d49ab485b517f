"""Commands stay in their ranges, are evenly spread, and depend on the seed alone."""

import numpy as np

from motorprior.locomotion.body import MAX_COMMAND
from motorprior.locomotion.command import Commands
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT

GAIT = ROBOT.require_legs()


def test_a_schedule_fills_what_the_robot_is_built_for_and_a_little_more():
    rows = np.concatenate([Commands().schedule(ROBOT, seed, 500) for seed in range(400)])
    assert GAIT.forward[0] <= rows[:, 0].min() < -0.18 and 0.58 < rows[:, 0].max() <= MAX_COMMAND * GAIT.forward[1]
    assert -GAIT.yaw_rate <= rows[:, 1].min() < -0.58 and 0.58 < rows[:, 1].max() <= GAIT.yaw_rate
    assert rows.shape == (200_000, 2) and rows.flags.c_contiguous


def test_a_command_is_held_and_the_last_one_may_be_cut_short():
    rows = Commands(hold=0.3, still=0.0).schedule(ROBOT, 4, 100)
    assert np.flatnonzero(np.diff(rows[:, 0])).tolist() == [29, 59, 89]
    assert len(Commands(hold=5.0).schedule(ROBOT, 4, 100)) == 100


def test_speeds_of_an_episode_are_one_of_each_part_of_the_range_in_any_order():
    first = []
    for seed in range(30):
        speeds = np.unique(Commands(hold=0.5, still=0.0).schedule(ROBOT, seed, 500)[:, 0])
        parts = (speeds - GAIT.forward[0]) / (MAX_COMMAND * GAIT.forward[1] - GAIT.forward[0]) * 10
        np.testing.assert_array_equal(np.floor(parts), np.arange(10))
        first.append(Commands(hold=0.5, still=0.0).schedule(ROBOT, seed, 500)[0, 0])
    assert np.ptp(first) > 0.5


def test_commands_beyond_the_robots_range_widen_it_and_others_leave_it():
    assert Commands((0.1, 0.3)).extend_range(ROBOT) == Commands().extend_range(ROBOT) == ROBOT
    assert Commands((-0.5, 0.3)).extend_range(ROBOT).require_legs().forward == (-0.5, GAIT.forward[1])
    assert Commands((0.1, 0.9)).extend_range(ROBOT).require_legs().forward == (GAIT.forward[0], 0.9)
