"""The shipped SO-101 and its fleets."""

import numpy as np
import pytest

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.robots.so101.robot import SO101
from motorprior.robots.user_model import UserModel
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World


def test_its_constants_are_those_of_its_model():
    model = UserModel(SO101.model.path, False, False, [])
    limits = {joint.name: (joint.lower, joint.upper) for joint in SO101.joints}

    assert limits == model.limits()
    assert SO101.num_links == model.num_links
    assert SO101.weight == pytest.approx(9.81 * model.mass)


def test_its_servos_and_fleets_are_its_own():
    chain = SO101.require_servos()

    assert len(chain.ids) == len(chain.signs) == len(chain.zeros) == SO101.num_joints
    assert chain.fleet in dict(SO101.fleets)
    for name, _ in SO101.fleets:
        fleet = load_fleet(name)
        assert fleet.robot == SO101.name
        assert fleet.sample(SO101.num_joints, 0).kp.shape == (SO101.num_joints,)


def test_it_can_be_simulated():
    motors = IdealPd.uniform(SO101.num_joints, 20.0, 1.0, 20.0, 0.01)
    target = np.tile(SO101.nominal_pose, (50, 1))

    played = replay(World(SO101), motors, target)

    assert np.isfinite(played.joint_pos).all()
