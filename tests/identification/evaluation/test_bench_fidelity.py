"""Closed-loop fidelity of ensembles on the bench and in the robot."""

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.identification.evaluation.bench_fidelity import Ensemble, held_out_trials, respond
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.studies.robot_fidelity import robot_fidelity

COUNT = 12


def pd(kp: float) -> IdealPd:
    return IdealPd.uniform(COUNT, kp, 0.5, 2.0, armature=0.002)


@pytest.fixture(scope="module")
def motors():
    return load_fleet("mixed").sample(COUNT, np.random.default_rng(4))


def test_an_ensemble_predicts_the_mean_of_its_members_trajectories():
    case = held_out_trials("gait", COUNT, 0)[0]
    soft, stiff = run(pd(4.0), case), run(pd(12.0), case)
    found = respond(Ensemble((pd(4.0), pd(12.0))), case)
    for name in ("joint_pos", "joint_vel", "joint_torque"):
        np.testing.assert_allclose(getattr(found, name), 0.5 * (getattr(soft, name) + getattr(stiff, name)))


def test_an_ensemble_of_one_is_its_member_inside_the_robot(motors):
    models = {"alone": lambda index: pd(8.0), "ensemble": lambda index: Ensemble((pd(8.0),))}
    found = robot_fidelity(PUPPER_V2, motors, models, True, 0)
    for figure in (found.rmse, found.torque_hf):
        np.testing.assert_array_equal(figure["ensemble"], figure["alone"])
