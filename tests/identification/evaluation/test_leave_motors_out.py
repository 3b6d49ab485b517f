"""A prior on unseen motors does not depend on their rows in the training log."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.identification.evaluation.leave_motors_out import leave_motors_out, motor_groups
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT

GROUP = [0, 2]
SECONDS = 2.0


@pytest.fixture
def logs() -> list[MotorLog]:
    """Two logs of four motors of fleet ``mixed``."""
    fleet = load_fleet("mixed")
    motors, names = fleet.sample(4, np.random.default_rng(5)), ROBOT.joint_names[:4]
    found = [record(motors, PRESETS["rollout"], 2000, seed, fleet) for seed in range(2)]
    return [replace(log, joint_names=names, joint_torque=None) for log in found]


def test_motors_left_out_are_tested_and_not_trained_on(logs: list[MotorLog], tmp_path: Path):
    found = leave_motors_out(logs[0], logs[1], ROBOT, GROUP, "pace", SECONDS, tmp_path / "a")
    names = tuple(ROBOT.joint_names[joint] for joint in GROUP)
    assert found.joints == names
    assert set(found.errors) == {"prior", "same_place", "adapted", "per_motor", "tuned_pd"}
    assert all(values.shape == (2,) and np.isfinite(values).all() for values in found.errors.values())
    assert len({float(values[0]) for values in found.errors.values()}) > 3
    assert all(0.0 <= share <= 1.0 for share in found.coverage.values())
    angles = logs[0].joint_pos.copy()
    angles[:, GROUP] *= 0.5
    again = leave_motors_out(replace(logs[0], joint_pos=angles), logs[1], ROBOT, GROUP, "pace", SECONDS, tmp_path / "b")
    for name, values in found.errors.items():
        np.testing.assert_array_equal(again.errors[name], values)


def test_the_motors_of_a_leg_are_left_out_together():
    groups = motor_groups(ROBOT)
    assert len(groups) == len(ROBOT.legs) and all(len(group) == 3 for group in groups)
    assert sorted(joint for group in groups for joint in group) == list(range(ROBOT.num_joints))
