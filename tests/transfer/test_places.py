"""Twins of a study: whose motors, which draws, and that no training, bench or other study has them."""

import numpy as np
import pytest
from scipy.stats import kstest

from motorprior.bench.facts import MOTORS_STREAM
from motorprior.bench.fleet import load_fleet
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import zero_policy
from motorprior.pipeline.transfer_study.study_conditions import LOG_STREAM
from motorprior.pipeline.virtual.twin_body import TWIN_STREAM as WIRE_STREAM
from motorprior.pipeline.walking.walk_seeds import SEEDS_APART
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.search.policy_search import CONTEST, CONTEST_DRAWS, episode_seed
from motorprior.simulation.rollout import WalkConfig
from motorprior.transfer.places import DRAW_STREAM, ROBOT_STREAM, TWINS, NumberedWalks, motors_of_robot, walk_seed
from motorprior.transfer.study import STUDY_SEED
from motorprior.transfer.twin import TWIN_STREAM
from motorprior.transfer.walk_measures import walk_measures

STEPS, STUDY = 200, 4
FLEET = load_fleet("pupper_v2")


def numbered(twin: str = "fleet", only: int | None = None) -> NumberedWalks:
    fleet = FLEET if TWINS[twin].population == "fleet" else load_fleet("foreign_direct")
    return NumberedWalks(ROBOT, TWINS[twin], fleet, WalkConfig(STEPS, commands=Commands.steady(0.2)), STUDY, only)


def test_streams_are_a_studys_own():
    assert len({ROBOT_STREAM, DRAW_STREAM, LOG_STREAM, TWIN_STREAM, WIRE_STREAM, MOTORS_STREAM}) == 6


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


def test_a_robot_has_one_battery_and_motors_of_one_kind():
    """A uniform range stays one over robots; of the variance a robot's motors have the stated share in common."""
    fleet = load_fleet("foreign_direct")
    robots = [fleet.sample(12, seed, of_one_robot=True) for seed in range(600)]
    for name, shared in (("sag", 1.0), ("armature", 0.5), ("asymmetry", 0.0)):
        drawn = np.array([getattr(motors, name) for motors in robots])
        values = fleet.parameters[name].values
        share = (drawn - values["low"]) / (values["high"] - values["low"])
        assert kstest(share[:, 0], "uniform").pvalue > 0.01
        between = np.corrcoef(share[:, 0], share[:, 1])[0, 1]
        assert between == pytest.approx(6.0 / np.pi * np.arcsin(shared / 2.0), abs=0.1), name


def test_a_walk_depends_on_its_draw_alone_and_one_robot_can_walk_all():
    policy = zero_policy(ROBOT.num_joints)
    walks = numbered()
    first, second, again = (walks.run(policy, draw).trace for draw in (0, 1, 0))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second)
    only = numbered(only=0)
    np.testing.assert_array_equal(only.run(policy, 0).trace, first)
    assert not np.array_equal(only.run(policy, 1).trace, second), "robot 0 in place of robot 1"


@pytest.mark.parametrize("twin", TWINS)
def test_every_twin_has_its_measures(twin: str):
    if TWINS[twin].engine == "pybullet":
        pytest.importorskip("pybullet")
    walks = numbered(twin)
    episode = walks.run(zero_policy(ROBOT.num_joints), 0)
    walks.close()
    found = walk_measures(ROBOT, episode, 0.2, STEPS)
    assert len(episode.trace) == STEPS and found["upright"] == 1.0
    assert found["speed"] == pytest.approx(episode.displacement[0] / (STEPS * ROBOT.control_dt))
    assert 0.05 < found["distance"] < 0.8 and 1.0 < found["step_frequency"] < 4.0 and found["foot_lift_mm"] > 5.0
    known = np.isfinite([found["transport"], found["torque_beyond"]])
    assert known.all() == (TWINS[twin].engine == "mujoco") and known.any() == known.all()


def test_velocities_of_an_engine_that_tells_none_come_from_its_poses():
    from motorprior.transfer.walk_measures import _motion_of

    walks = numbered()
    episode = walks.run(zero_policy(ROBOT.num_joints), 0)
    told, found = episode.motion[1:-1], _motion_of(ROBOT, episode.trace)[1:-1]
    for columns in (slice(0, 3), slice(3, 6)):
        one, other = told[:, columns].ravel(), found[:, columns].ravel()
        assert np.corrcoef(one, other)[0, 1] > 0.9
        assert np.std(other) == pytest.approx(np.std(one), rel=0.2)


def test_a_walk_that_fell_has_gone_no_further():
    walks = numbered()
    episode = walks.run(zero_policy(ROBOT.num_joints), 0)
    whole = walk_measures(ROBOT, episode, 0.2, STEPS)
    longer = walk_measures(ROBOT, episode, 0.2, 2 * STEPS)
    assert longer["speed"] == pytest.approx(0.5 * whole["speed"]) and longer["distance"] == whole["distance"]
    assert longer["upright"] == pytest.approx((STEPS - 1) / (2 * STEPS)), "it ended early, so it fell in its last step"
