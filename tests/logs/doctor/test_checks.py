"""The log doctor finds what was done to a healthy log, and nothing in one that is."""

import numpy as np
import pytest

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.formats.puppersim import read_puppersim_logs
from motorprior.logs.resampling import drop_repeats
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import JOINT_LOWER, JOINT_UPPER


def bad(report, check):
    return [finding for finding in report.of(check) if finding.severity != "info"]


def test_a_healthy_log_has_no_complaints(rich_log):
    report = check_log(rich_log, np.array([[-1.0, 1.0]] * 2))
    assert report.usable
    assert {finding.severity for finding in report.findings} == {"info"}
    assert all(finding.row is not None for finding in report.findings)


def test_lag_and_rate_are_measured(make_log):
    report = check_log(make_log())
    assert report.of("rate")[0].value == pytest.approx(100.0)
    assert [finding.value for finding in report.of("tracking")] == pytest.approx([0.05, 0.05])


def test_a_gap_names_its_row(make_log):
    log = make_log()
    log.time[120:] += 0.2
    (finding,) = bad(check_log(log), "gaps")
    assert finding.row == 120
    assert finding.value == pytest.approx(0.21)


def test_an_angle_beyond_its_limit_is_named(make_log):
    log = make_log()
    log.joint_pos[42, 0] = -0.9
    (finding,) = bad(check_log(log, np.array([[-0.5, 0.5]] * 2)), "limits")
    assert (finding.joint, finding.row, finding.value, finding.bound) == ("left", 42, -0.9, -0.5)


def test_dead_and_idle_joints_are_told_apart(make_log):
    log = make_log()
    log.joint_pos[:, 0] = 0.25
    log.position_target[:, 1] = 0.1
    report = check_log(log)
    assert [finding.joint for finding in bad(report, "excitation")] == ["left"]
    assert [finding.joint for finding in bad(report, "constant")] == ["left"]
    assert "right is not excited" in report.of("excitation")[-1].message


def test_a_log_without_excitation_is_unusable(make_log):
    report = check_log(make_log(position_target=np.zeros((200, 2))))
    assert [finding.check for finding in report.errors] == ["excitation"]


@pytest.mark.parametrize("rows", [2, 3, 10])
def test_a_very_short_log_is_no_crash(make_log, rows):
    check_log(make_log(rows=rows))


def test_the_published_logs_are_usable(pupper_folder):
    limits = np.stack([JOINT_LOWER, JOINT_UPPER], axis=1)
    for name, log in read_puppersim_logs(pupper_folder, PUPPER_V2).items():
        report = check_log(log, limits)
        assert report.usable, (name, report.errors)
        assert not report.of("limits"), name
        assert bool(bad(report, "repeats")) == (name == "0116")
        for finding in report.of("tracking"):
            assert 0.08 < finding.value < 0.12, (name, finding)
        assert check_log(drop_repeats(log)).of("repeats") == ()
