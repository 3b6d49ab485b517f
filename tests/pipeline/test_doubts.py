"""What a user is told of a prior before anything is trained on it, and whose notes he hears."""

import io
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.logs.motor_log import PHYSICAL_GAINS
from motorprior.pipeline.prior_file import doubts
from motorprior.pipeline.progress import Lines, WithoutNotes
from motorprior.robots.pupper_v2.robot import PUPPER_V2

DESCRIBED = np.array([[joint.kp for joint in PUPPER_V2.joints], [joint.kd for joint in PUPPER_V2.joints]])


@pytest.fixture
def prior(grey_network) -> MotorPrior:
    network = replace(grey_network(spread=0.3), gain_unit=PHYSICAL_GAINS)
    return MotorPrior(network, np.zeros((12, 3)), np.zeros((12, 3)), "rollout", "pupper_v2", "m", {}, {}, (), DESCRIBED)


def test_gains_that_the_description_has_are_no_doubt(prior: MotorPrior):
    assert doubts(prior, PUPPER_V2) == []
    assert doubts(replace(prior, gains=DESCRIBED[:, :3]), PUPPER_V2) == [], "of other motors, with the same gains"


def test_gains_that_the_description_has_not_are_told(prior: MotorPrior):
    (line,) = doubts(replace(prior, gains=2.0 * DESCRIBED), PUPPER_V2)
    kp = DESCRIBED[0, 0]
    assert f"the prior's logs state kp {2 * kp:.3g} to {2 * kp:.3g} and kd" in line
    assert f"the description of pupper_v2 says kp {kp:.3g}" in line


def test_gains_of_other_joints_are_told_and_another_order_is_not(prior: MotorPrior):
    uneven = DESCRIBED * np.linspace(0.5, 1.5, 12)
    robot = replace(
        PUPPER_V2,
        joints=tuple(
            replace(joint, kp=kp, kd=kd) for joint, kp, kd in zip(PUPPER_V2.joints, *uneven.tolist(), strict=True)
        ),
    )
    names = robot.joint_names[::-1]
    assert doubts(replace(prior, gains=uneven[:, ::-1], joint_names=names), robot) == []
    (line,) = doubts(replace(prior, gains=uneven, joint_names=names), robot)
    assert "says the same for other joints" in line


def test_of_a_baseline_the_work_is_shown_and_no_note():
    said = io.StringIO()
    progress = WithoutNotes(Lines(said))
    with progress.start("fit a baseline", 1) as task:
        task.advance()
    progress.note("warning: its motors lack physics")
    assert "fit a baseline" in said.getvalue() and "warning" not in said.getvalue()
