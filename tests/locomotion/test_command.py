"""What a robot is told to do stays within its ranges, comes back for the same seed, and is spread evenly."""

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import BEYOND
from motorprior.locomotion.command import Commands
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT

GAIT = ROBOT.require_legs()
DT = ROBOT.control_dt


def test_a_schedule_fills_what_the_robot_is_built_for_and_a_little_more():
    rows = np.concatenate([Commands().schedule(ROBOT, seed, 500) for seed in range(400)])
    assert GAIT.forward[0] <= rows[:, 0].min() < -0.18 and 0.58 < rows[:, 0].max() <= BEYOND * GAIT.forward[1]
    assert -GAIT.yaw_rate <= rows[:, 1].min() < -0.58 and 0.58 < rows[:, 1].max() <= GAIT.yaw_rate
    assert rows.shape == (200_000, 2) and rows.flags.c_contiguous


def test_given_ranges_are_kept():
    given = Commands(forward=(0.1, 0.2), yaw_rate=(0.0, 0.3), still=0.0)
    rows = np.concatenate([given.schedule(ROBOT, seed, 500) for seed in range(20)])
    assert rows[:, 0].min() >= 0.1 and rows[:, 0].max() <= 0.2 and rows[:, 1].min() >= 0.0 and rows[:, 1].max() <= 0.3


def test_a_command_is_held_and_the_last_one_may_be_cut_short():
    rows = Commands(hold=0.3, still=0.0).schedule(ROBOT, 4, 100)
    assert np.flatnonzero(np.diff(rows[:, 0])).tolist() == [29, 59, 89]
    assert len(Commands(hold=5.0).schedule(ROBOT, 4, 100)) == 100


def test_speeds_of_an_episode_are_one_of_each_part_of_the_range_in_any_order():
    first = []
    for seed in range(30):
        speeds = np.unique(Commands(hold=0.5, still=0.0).schedule(ROBOT, seed, 500)[:, 0])
        parts = (speeds - GAIT.forward[0]) / (BEYOND * GAIT.forward[1] - GAIT.forward[0]) * 10
        np.testing.assert_array_equal(np.floor(parts), np.arange(10))
        first.append(Commands(hold=0.5, still=0.0).schedule(ROBOT, seed, 500)[0, 0])
    assert np.ptp(first) > 0.5


def test_shares_of_standing_and_of_straight_walks():
    rows = np.concatenate(
        [Commands(hold=0.1, straight=0.3, still=0.2).schedule(ROBOT, s, 1000)[::10] for s in range(40)]
    )
    still = ~rows.any(axis=1)
    assert np.mean(still) == pytest.approx(0.2, abs=0.03)
    assert np.mean(rows[~still, 1] == 0.0) == pytest.approx(0.3, abs=0.03)
    always = Commands(still=1.0).schedule(ROBOT, 0, 500)
    assert not always.any()


def test_the_same_seed_is_the_same_schedule_and_another_is_another():
    one, again, other = (Commands().schedule(ROBOT, seed, 500) for seed in (3, 3, 4))
    assert one.tobytes() == again.tobytes() != other.tobytes()


def test_a_steady_command_is_the_same_from_beginning_to_end():
    for seed in (0, 1):
        np.testing.assert_array_equal(
            Commands.steady(0.3, -0.2).schedule(ROBOT, seed, 300), np.tile([0.3, -0.2], (300, 1))
        )
    assert not Commands.steady(0.0).schedule(ROBOT, 0, 10).any()


def test_what_json_made_of_a_range_is_a_range():
    assert Commands(forward=[0.0, 0.3]) == Commands(forward=(0.0, 0.3))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("forward", (0.3, 0.1)), ("forward", 0.3), ("forward", (0.0, np.nan)), ("yaw_rate", (0.0, 11.0)),
        ("yaw_rate", (0.0, 0.1, 0.2)), ("hold", 0.0), ("hold", "1"), ("straight", 1.1), ("still", -0.1),
        ("still", True),
    ],
)  # fmt: skip
def test_an_impossible_command_is_refused_by_the_name_it_has_on_the_command_line(name, value):
    with pytest.raises(ConfigError, match=rf"commands\.{name} "):
        Commands(**{name: value})


def test_commands_beyond_the_robots_range_widen_it_and_others_leave_it():
    assert Commands((0.1, 0.3)).on(ROBOT) == Commands().on(ROBOT) == ROBOT
    assert Commands((-0.5, 0.3)).on(ROBOT).require_legs().forward == (-0.5, GAIT.forward[1])
    assert Commands((0.1, 0.9)).on(ROBOT).require_legs().forward == (GAIT.forward[0], 0.9)


def test_turns_beyond_the_robots_are_refused_and_slower_ones_not():
    with pytest.raises(ConfigError, match=r"yaw_rate \(-1\.5, 1\.5\).*-0\.6\.\.0\.6") as refused:
        Commands(yaw_rate=(-1.5, 1.5)).on(ROBOT)
    assert refused.value.argument == "commands.yaw_rate"
    assert Commands(yaw_rate=(0.0, 0.6)).on(ROBOT) == ROBOT


def test_what_a_training_tells_beyond_the_robots_range_its_policy_may_not_be_told():
    told = Commands(still=0.0).schedule(ROBOT, 0, 1000)[:, 0]
    assert len({*told}) == 4, "four commands in ten seconds"
    assert told.max() > GAIT.forward[1] == Commands().on(ROBOT).require_legs().forward[1]
