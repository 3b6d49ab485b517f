"""Test environments of a study have motors and seeds of no training, bench or other study."""

from functools import partial

import numpy as np
import pytest
from policies import random_policy

from motorprior.actuator.fleet import Fleet, load_fleet
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy_search import EVALUATION, EVALUATION_EPISODES, episode_seed
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.simulation.scene import WalkConfig
from motorprior.studies.compare import EVALUATION_SEED, run_walks
from motorprior.studies.environments import held_out_scene, motors_of_robot, walk_seed
from motorprior.studies.transfer import SEEDS_APART

STEPS = 200
STUDY = 4
FLEET = load_fleet("pupper_v2")


def test_no_walk_has_a_training_seed():
    walked = {walk_seed(STUDY, draw) for draw in range(64)}
    assert len(walked) == 64

    episodes = [(iteration, direction) for iteration in range(100) for direction in range(16)]
    episodes += [(EVALUATION, draw) for draw in range(EVALUATION_EPISODES)]
    trained = set()
    for policy in range(8):
        policy_seed = SEEDS_APART * STUDY + policy
        for iteration, direction in episodes:
            trained.add(episode_seed(policy_seed, iteration, direction))
    assert not walked & trained

    evaluated = set(range(EVALUATION_SEED, EVALUATION_SEED + 64))
    assert not walked & evaluated


def kp_of_robot(fleet: Fleet, study: int, number: int) -> np.ndarray:
    """(joints,) gains of the robot with this number."""
    motors = motors_of_robot(ROBOT, fleet, study, number)
    return motors.kp  # pyright: ignore[reportAttributeAccessIssue]


def test_the_motors_of_a_robot_depend_on_its_number_its_study_and_its_fleet():
    kp = kp_of_robot(FLEET, study=4, number=3)
    np.testing.assert_array_equal(kp_of_robot(FLEET, study=4, number=3), kp)

    # both fleets begin with the same range of kp
    kp_of_mixed = kp_of_robot(load_fleet("mixed"), study=4, number=3)
    kp_of_direct = kp_of_robot(load_fleet("foreign_direct"), study=4, number=3)
    assert (kp_of_robot(FLEET, study=4, number=4) != kp).all()
    assert (kp_of_robot(FLEET, study=5, number=3) != kp).all()
    assert (kp_of_mixed != kp).all()
    assert (kp_of_direct != kp).all()
    assert (kp_of_direct != kp_of_mixed).all()


def deviation_of_robots(of_one_robot: bool) -> float:
    """Standard deviation of the mean log(kp) of 100 motors, over 200 seeds."""
    means = []
    for seed in range(200):
        motors = FLEET.sample(100, seed, of_one_robot=of_one_robot)
        means.append(np.log(motors.kp).mean())  # pyright: ignore[reportAttributeAccessIssue]
    return float(np.std(means))


def test_the_error_of_the_center_is_the_same_for_all_motors_of_a_robot():
    """The means vary by the uncertainty of the center if it is drawn once, and barely otherwise."""
    uncertainty = FLEET.parameters["kp"].values["center_uncertainty"]
    assert deviation_of_robots(of_one_robot=True) == pytest.approx(uncertainty, rel=0.2)
    assert deviation_of_robots(of_one_robot=False) < 0.3 * uncertainty


def test_a_walk_depends_on_its_draw_alone():
    policy = random_policy(0.0, 0)
    scene = held_out_scene(ROBOT, FLEET, WalkConfig(STEPS, commands=Commands.steady(0.2)))

    def walks(*draws: int, only: int | None = None) -> list[np.ndarray]:
        """Traces of walks; all on the robot ``only``, or each on the robot of its draw."""

        def motors(draw: int):
            number = draw if only is None else only
            return motors_of_robot(ROBOT, FLEET, STUDY, number).actuator()

        episodes = run_walks(scene, policy, draws, partial(walk_seed, STUDY), motors)
        return [episode.trace for episode in episodes]

    first, second, first_repeated = walks(0, 1, 0)
    np.testing.assert_array_equal(first, first_repeated)
    assert not np.array_equal(first, second)

    first_on_robot_0, second_on_robot_0 = walks(0, 1, only=0)
    np.testing.assert_array_equal(first_on_robot_0, first)
    assert not np.array_equal(second_on_robot_0, second), "robot 0 in place of robot 1"
