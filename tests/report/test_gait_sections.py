"""Gait diagrams: a bar is where a foot is on the ground."""

import numpy as np
from matplotlib.collections import Collection

from motorprior.report.gait_sections import gaits, measured_stance
from motorprior.report.plots_gait import footfalls
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def standing(frames: int) -> np.ndarray:
    qpos = np.zeros((frames, 19))
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height, 1.0, PUPPER_V2.nominal_pose
    return qpos


def extents(bars: Collection) -> list[tuple[float, float]]:
    ends = [np.asarray(path.vertices, float)[:, 0] for path in bars.get_paths()]
    return [(float(each.min()), float(each.max())) for each in ends]


def test_a_bar_begins_where_a_foot_comes_down_and_ends_where_it_leaves():
    stance = np.zeros((10, 3), dtype=bool)
    stance[2:5, 0] = stance[7:, 0] = stance[:, 1] = True
    (axes,) = footfalls({"one": stance}, ["a", "b", "c"], 2.0, "cycles [-]").axes
    found = [extents(bars) for bars in axes.collections]
    np.testing.assert_allclose(found[0], [(0.4, 1.0), (1.4, 2.0)])
    np.testing.assert_allclose(found[1], [(0.0, 2.0)])
    assert found[2] == []
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b", "c"]
    assert "60 / 100 / 0 %" in axes.texts[0].get_text()


def test_a_foot_is_on_the_ground_until_it_is_lifted():
    trace = standing(4)
    trace[2:, 7 + PUPPER_V2.legs[1].joints[2]] *= 1.3  # flexed further
    stance = measured_stance(PUPPER_V2, trace)
    assert stance[:2].all() and stance[2:].sum(axis=0).tolist() == [2, 0, 2, 2]


def test_a_walk_that_ends_at_once_has_no_pictures_and_another_has_three():
    section = gaits(PUPPER_V2, {"ideal_pd": standing(30), "paper": standing(5)}, 0.01)
    assert [picture.kind for picture in section.pictures] == ["gif", "png", "png"]
    assert "which foot is on the ground" in section.pictures[-1].caption
