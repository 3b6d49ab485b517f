"""A log with an invalid channel is refused by row, channel and value."""

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import checked
from motorprior.logs.operations import joined


def test_time_may_restart_with_a_segment(make_log):
    time = np.array([0.0, 1.0, 0.0, 1.0])

    assert checked(make_log(rows=4, time=time, segment=np.array([0, 0, 1, 1]))).duration == 2.0
    with pytest.raises(LogError, match="row 2, time"):
        checked(make_log(rows=4, time=time))


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"joint_names": ("one",)}, r"position_target .*\(200, 2\).*\(200, 1\)"),
        ({"joint_names": ("a", "a")}, r"\['a', 'a'\]"),
        ({"joint_pos": np.full((200, 2), -np.inf)}, "row 0, joint_pos/left .*-inf"),
        ({"segment": np.zeros(200)}, "segment"),
        ({"segment": np.repeat([0, 7], [199, 1])}, "segment 7"),
        ({"posture": np.repeat([0, 4], [30, 170])}, "row 30, posture .*4"),
        ({"joint_pos": [["x", "y"]] * 200}, "joint_pos"),
        ({"load_inertia": np.zeros((200, 2))}, "row 0, load_inertia/left .*0"),
        (
            {"supply_voltage": np.full((200, 2), 1e4)},
            "row 0, supply_voltage/left .*10000.*2000 V",
        ),
    ],
)
def test_an_invalid_channel_is_refused_by_row_and_value(make_log, changes, place):
    with pytest.raises(LogError, match=place):
        checked(make_log(**changes))


def test_logs_of_another_firmware_are_not_joined(make_log):
    logs = [make_log(firmware={"profile_speed": speed}) for speed in (3.0, 3.0, 4.0)]
    within_tolerance = make_log(firmware={"profile_speed": 3.01})

    assert joined([*logs[:2], within_tolerance]).firmware == {"profile_speed": 3.0}

    with pytest.raises(LogError, match=r"profile_speed .*4.*3"):
        joined(logs)
    with pytest.raises(LogError, match="profile_speed"):
        joined([logs[0], make_log()])


def test_gains_that_change_within_a_segment_are_part_of_the_command(make_log):
    log = make_log()
    kp = np.full(log.joint_pos.shape, 2.0)
    kp[log.num_rows // 2 :] = 3.0
    halves = np.arange(log.num_rows) // (log.num_rows // 2)

    changing = checked(make_log(logged_kp=kp))
    in_segments = checked(make_log(logged_kp=kp, segment=np.minimum(halves, 1)))

    assert changing.has_command_frames
    assert not in_segments.has_command_frames
