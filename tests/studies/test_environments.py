"""Test environments of a study have their own motors and seeds, of no training, bench or other study."""

from functools import partial

import numpy as np
import pytest
from policies import random_policy

from motorprior.actuator.fleet import load_fleet
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
    study = STUDY
    walked = {walk_seed(study, draw) for draw in range(64)}
    rounds = [(iteration, direction) for iteration in range(100) for direction in range(16)]
    rounds += [(EVALUATION, draw) for draw in range(EVALUATION_EPISODES)]
    trained = {
        episode_seed(SEEDS_APART * study + policy, *each) for policy in range(8) for each in rounds
    }
    assert (
        len(walked) == 64
        and not walked & trained
        and not walked & set(range(EVALUATION_SEED, EVALUATION_SEED + 64))
    )


def test_the_motors_of_a_robot_depend_on_its_number_its_study_and_its_fleet():
    cases = [(FLEET, 4, 3), (FLEET, 4, 3), (FLEET, 4, 4), (FLEET, 5, 3)]
    # both begin with the same range of kp
    cases += [(load_fleet(name), 4, 3) for name in ("mixed", "foreign_direct")]
    one, same, *others = (motors_of_robot(ROBOT, *case).kp for case in cases)  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_array_equal(one, same)
    assert all((one != other).all() for other in others) and (others[-1] != others[-2]).all()


def test_the_error_of_the_center_is_the_same_for_all_motors_of_a_robot():
    """Means over robots of 100 motors vary by the center's uncertainty if it is drawn once, and barely otherwise."""
    spread = FLEET.parameters["kp"].values
    means = {
        once: np.std(
            [np.log(FLEET.sample(100, seed, of_one_robot=once).kp).mean() for seed in range(200)]
        )  # pyright: ignore[reportAttributeAccessIssue]
        for once in (True, False)
    }
    assert means[True] == pytest.approx(spread["center_uncertainty"], rel=0.2)
    assert means[False] < 0.3 * spread["center_uncertainty"]


def test_a_walk_depends_on_its_draw_alone():
    policy = random_policy(0.0, 0)
    scene = held_out_scene(ROBOT, FLEET, WalkConfig(STEPS, commands=Commands.steady(0.2)))

    def walks(*draws: int, only: int | None = None) -> list[np.ndarray]:
        def motors(draw: int):
            return motors_of_robot(ROBOT, FLEET, STUDY, draw if only is None else only).actuator()

        return [
            each.trace
            for each in run_walks(scene, policy, draws, partial(walk_seed, STUDY), motors)
        ]

    first, second, again = walks(0, 1, 0)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second)
    same, other = walks(0, 1, only=0)
    np.testing.assert_array_equal(same, first)
    assert not np.array_equal(other, second), "robot 0 in place of robot 1"
