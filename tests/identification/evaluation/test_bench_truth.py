"""Closed-loop fidelity of ensembles, and of models that diverge, on the bench and in the robot."""

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.identification.evaluation.bench_truth import bench_errors, held_out_trials, respond
from motorprior.identification.evaluation.errors import MAX_ERROR

COUNT = 12


def pd(kp: float) -> IdealPd:
    return IdealPd.uniform(COUNT, kp, 0.5, 2.0, armature=0.002)


@pytest.fixture(scope="module")
def motors():
    return load_fleet("mixed").sample(COUNT, np.random.default_rng(4))


def test_an_ensemble_predicts_the_mean_of_its_members_trajectories(motors):
    case, _ = held_out_trials("gait", motors, 0)[0]
    soft, stiff = run(pd(4.0), case), run(pd(12.0), case)
    found = respond((pd(4.0), pd(12.0)), case)
    for name in ("joint_pos", "joint_vel", "joint_torque"):
        np.testing.assert_allclose(getattr(found, name), 0.5 * (getattr(soft, name) + getattr(stiff, name)))


def test_a_model_that_diverges_is_one_turn_off(motors):
    unstable = IdealPd.uniform(COUNT, -50.0, 0.0, 1e9)
    errors = bench_errors(motors, {"unstable": lambda index: unstable}, 0)["impacts"]
    assert np.all(errors["unstable"] == MAX_ERROR) and np.all(errors["physical"] < 0.1)
