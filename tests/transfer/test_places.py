"""Twins of a study: whose motors, which draws, and that no training, bench or other study has them."""

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import zero_policy
from motorprior.pipeline.walking.walk_seeds import SEEDS_APART
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.search.policy_search import CONTEST, CONTEST_DRAWS, episode_seed
from motorprior.simulation.rollout import WalkConfig
from motorprior.transfer.places import TWINS, NumberedWalks, motors_of_robot, walk_seed
from motorprior.transfer.study import STUDY_SEED

STEPS, STUDY = 200, 4
FLEET = load_fleet("pupper_v2")


def numbered(twin: str = "fleet", only: int | None = None) -> NumberedWalks:
    fleet = FLEET if TWINS[twin].population == "fleet" else load_fleet("foreign_direct")
    return NumberedWalks(ROBOT, TWINS[twin], fleet, WalkConfig(STEPS, commands=Commands.steady(0.2)), STUDY, only)


@pytest.mark.parametrize("study", range(6))
def test_no_walk_has_the_seed_of_an_episode_of_training(study: int):
    walked = {walk_seed(study, draw) for draw in range(64)}
    rounds = [(iteration, direction) for iteration in range(100) for direction in range(16)]
    rounds += [(CONTEST, draw) for draw in range(CONTEST_DRAWS)]
    trained = {episode_seed(SEEDS_APART * study + policy, *each) for policy in range(8) for each in rounds}
    assert len(walked) == 64 and not walked & trained and not walked & set(range(STUDY_SEED, STUDY_SEED + 64))


def test_a_robot_has_the_same_motors_in_every_walk_and_another_has_others():
    one, same, other = (motors_of_robot(ROBOT, FLEET, STUDY, number) for number in (3, 3, 4))
    np.testing.assert_array_equal(one.kp, same.kp)  # pyright: ignore[reportAttributeAccessIssue]
    assert (one.kp != other.kp).all()  # pyright: ignore[reportAttributeAccessIssue]
    abroad = motors_of_robot(ROBOT, FLEET, STUDY + 1, 3)
    assert (one.kp != abroad.kp).all(), "robot 3 of another study"  # pyright: ignore[reportAttributeAccessIssue]


def test_robots_of_two_fleets_share_nothing():
    """The files of both fleets begin with the same range of kp."""
    mixed, foreign = (motors_of_robot(ROBOT, load_fleet(name), STUDY, 3) for name in ("mixed", "foreign_direct"))
    assert (mixed.kp != foreign.kp).all()  # pyright: ignore[reportAttributeAccessIssue]


def test_what_is_not_known_of_the_center_is_the_same_for_a_robots_motors():
    """Means over robots of 100 motors vary by the center's uncertainty if it is drawn once, and hardly otherwise."""
    spread = FLEET.parameters["kp"].values
    means = {
        once: np.std([np.log(FLEET.sample(100, seed, of_one_robot=once).kp).mean() for seed in range(200)])  # pyright: ignore[reportAttributeAccessIssue]
        for once in (True, False)
    }
    assert means[True] == pytest.approx(spread["center_uncertainty"], rel=0.2)
    assert means[False] < 0.3 * spread["center_uncertainty"]
    within = [np.log(FLEET.sample(100, seed, of_one_robot=True).kp).std() for seed in range(50)]  # pyright: ignore[reportAttributeAccessIssue]
    assert np.mean(within) == pytest.approx(spread["spread"], rel=0.1)


def test_a_walk_depends_on_its_draw_alone_and_one_robot_can_walk_all():
    policy = zero_policy(ROBOT.num_joints)
    walks = numbered()
    first, second, again = (walks.run(policy, draw).trace for draw in (0, 1, 0))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second)
    only = numbered(only=0)
    np.testing.assert_array_equal(only.run(policy, 0).trace, first)
    assert not np.array_equal(only.run(policy, 1).trace, second), "robot 0 in place of robot 1"
