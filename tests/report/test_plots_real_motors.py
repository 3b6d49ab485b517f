"""Pictures of real motors leave none of them out in silence."""

import numpy as np

from motorprior.report.plots_real_motors import LOWEST, constants_beside_fleet


def test_every_motor_is_within_the_axis_or_has_an_arrow():
    motors = {"armature": [0.5, 40.0], "delay": [0.001, 0.002, 0.9]}
    (axes,) = constants_beside_fleet(motors, dict.fromkeys(motors, (0.8, 1.0, 1.2)), "f").axes
    low, high = axes.get_xlim()
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    drawn = np.concatenate([np.asarray(line.get_xdata()) for line in dots])
    assert sorted(drawn) == [0.5, 0.9, 40.0] and low < drawn.min() and drawn.max() < high
    (arrow,) = [line for line in axes.lines if line.get_marker() == "<"]
    assert arrow.get_xdata() == [LOWEST] and arrow.get_ydata() == [1]
    assert [text.get_text() for text in axes.texts] == [f"2 below {LOWEST:g}"]
