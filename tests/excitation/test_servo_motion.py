"""Motions of servos: limits, joints alone and together, poses, errors."""

import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.excitation.servo_motion import motion_range, servo_parts
from motorprior.robots.so101.robot import SO101

NAMES = SO101.joint_names
PERIOD = 0.005
SIGNALS = 4  # of each joint alone


def parts_of(amplitude: float = 0.5, loaded: np.ndarray | None = None, **changes):
    motion = motion_range(NAMES, SO101.lower, SO101.upper, SO101.nominal_pose, amplitude)
    settings = {"period": PERIOD, "seconds": 60.0, "seed": 0} | changes
    return servo_parts(NAMES, motion, loaded, **settings)


def poses_of_two() -> np.ndarray:
    """Poses in which the second and the third joint are loaded, the same for both."""
    poses = np.tile(SO101.nominal_pose, (len(NAMES), 1))
    poses[1:3, 1] = 0.2
    return poses


def ways(parts) -> list[np.ndarray]:
    return [part.targets for part in parts if part.name.startswith("way")]


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

    assert np.sum(alone, axis=0).tolist() == [SIGNALS] * len(NAMES)
    assert sum(mask.all() for mask in moving) == 3
    assert sum(len(part.targets) for part in parts) == pytest.approx(60.0 / PERIOD, rel=0.01)


def test_a_joint_sweeps_and_holds_in_its_own_pose_and_steps_in_the_nominal_one():
    poses = poses_of_two()

    for part in parts_of(loaded=poses):
        name, _, signal = part.name.partition(": ")
        if name not in NAMES:
            continue
        index = NAMES.index(name)
        pose = poses[index] if signal in ("sweep", "holds at both ends") else SO101.nominal_pose
        others = np.arange(len(NAMES)) != index
        np.testing.assert_allclose(
            part.targets[:, others], np.tile(pose[others], (len(part.targets), 1))
        )
        assert part.targets[0, index] == pytest.approx(pose[index])


def test_every_part_begins_where_the_last_one_ended():
    parts = parts_of(loaded=poses_of_two())
    ends = [SO101.nominal_pose, *(part.targets[-1] for part in parts)]

    for part, end in zip(parts, ends[:-1], strict=True):
        assert np.abs(part.targets[0] - end).max() < 0.01
    np.testing.assert_allclose(ends[-1], SO101.nominal_pose, atol=1e-9)


def test_ways_are_slow_and_lead_by_the_nominal_pose():
    poses = poses_of_two()
    poses[2, 2] = 0.9
    there, between, back = ways(parts_of(loaded=poses))

    for way in (there, between, back):
        assert np.abs(np.diff(way, axis=0)).max() / PERIOD < 0.51
    assert np.abs(between - SO101.nominal_pose).max(axis=1).min() < 1e-9
    assert ways(parts_of()) == []


def test_a_joint_is_held_at_both_ends_of_its_motion():
    (holds,) = [
        part.targets[:, 2] for part in parts_of() if part.name == "elbow_flex: holds at both ends"
    ]
    static = holds[:-1][np.diff(holds) == 0.0]

    assert set(np.round(static, 9)) == {-0.5, 0.5}


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
        motion_range(NAMES, SO101.lower, upper, SO101.nominal_pose, 0.5)
