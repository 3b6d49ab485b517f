"""Motions of servos: limits, joints alone and together, errors."""

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.excitation.servo_motion import servo_parts
from motorprior.robots.so101.robot import SO101

NAMES = SO101.joint_names
PERIOD = 0.005


def parts_of(**changes):
    settings = {"period": PERIOD, "seconds": 60.0, "amplitude": 0.5, "seed": 0} | changes
    return servo_parts(NAMES, SO101.lower, SO101.upper, SO101.nominal_pose, **settings)


@pytest.mark.parametrize("amplitude", [0.2, 0.5, 2.0])
def test_targets_keep_to_the_amplitude_and_away_from_the_limits(amplitude: float):
    for part in parts_of(amplitude=amplitude):
        center = part.targets[0]
        assert np.abs(part.targets - center).max() <= amplitude + 1e-9
        assert (part.targets >= SO101.lower + 0.1 - 1e-9).all()
        assert (part.targets <= SO101.upper - 0.1 + 1e-9).all()


def test_every_joint_moves_alone_and_all_move_together():
    parts = parts_of()
    moving = [np.ptp(part.targets, axis=0) > 1e-3 for part in parts]
    alone = [mask for mask in moving if mask.sum() == 1]

    assert np.sum(alone, axis=0).tolist() == [3] * len(NAMES)
    assert sum(mask.all() for mask in moving) == 3
    assert sum(len(part.targets) for part in parts) == pytest.approx(60.0 / PERIOD, rel=0.01)


def test_every_part_begins_and_ends_at_one_pose():
    ends = [part.targets[row] for part in parts_of() for row in (0, -1)]

    np.testing.assert_allclose(ends, np.tile(ends[0], (len(ends), 1)), atol=1e-9)


def test_steps_are_faster_than_sweeps():
    speeds = {}
    for part in parts_of():
        joint, _, signal = part.name.partition(": ")
        if joint == "elbow_flex":
            speeds[signal] = np.abs(np.diff(part.targets[:, 2])).max() / PERIOD

    assert speeds["sweep"] < 0.3 < 1.0 < speeds["chirp"] < speeds["steps"]


def test_equal_seeds_give_equal_targets_and_others_differ():
    same = [np.concatenate([part.targets for part in parts_of(seed=3)]) for _ in range(2)]
    other = np.concatenate([part.targets for part in parts_of(seed=4)])

    np.testing.assert_array_equal(same[0], same[1])
    assert not np.array_equal(same[0], other)


def test_a_joint_without_room_and_a_short_time_are_refused():
    with pytest.raises(ConfigError, match="seconds 5"):
        parts_of(seconds=5.0)
    upper = SO101.upper.copy()
    upper[2] = SO101.lower[2] + 0.1
    with pytest.raises(ConfigError, match="elbow_flex"):
        servo_parts(NAMES, SO101.lower, upper, SO101.nominal_pose, period=PERIOD)
