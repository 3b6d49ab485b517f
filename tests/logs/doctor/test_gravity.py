"""The log doctor finds joint signs that contradict gravity, where gravity has an effect."""

from dataclasses import replace
from pathlib import Path

import pytest
from motor_logs import of_check
from weighed_arm import JOINTS, slow_motion, write_arm

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import load_robot


@pytest.fixture
def arm(tmp_path: Path) -> str:
    return write_arm(tmp_path)


def turned(log: MotorLog, *signs: float) -> MotorLog:
    return replace(
        log, position_target=log.position_target * signs, joint_pos=log.joint_pos * signs
    )


def findings_of_gravity(log: MotorLog, robot: str) -> list[Finding]:
    return of_check(check_log(log, load_robot(robot)), "gravity")


def test_a_log_with_the_signs_of_the_model_has_no_finding(arm: str):
    assert not findings_of_gravity(slow_motion(arm), arm)


@pytest.mark.parametrize("joint", JOINTS)
def test_a_turned_sign_is_a_warning_that_names_its_joint(arm: str, joint: str):
    signs = [-1.0 if name == joint else 1.0 for name in JOINTS]

    (finding,) = findings_of_gravity(turned(slow_motion(arm), *signs), arm)

    assert (finding.severity, finding.joint) == ("warning", joint)
    assert finding.value > 0.99
    assert f"0.0 mrad with {joint} reversed" in finding.message


@pytest.mark.parametrize(
    "change",
    [
        lambda log: replace(log, time=0.1 * log.time),  # ten times as fast: not steady
        # an integral in the servo leaves no error
        lambda log: replace(log, joint_pos=log.position_target),
        lambda log: log.rows(slice(0, 25)),
    ],
)
def test_a_log_in_which_gravity_has_no_effect_has_no_finding(arm: str, change):
    log = turned(slow_motion(arm), -1.0, 1.0)

    assert not findings_of_gravity(change(log), arm)
