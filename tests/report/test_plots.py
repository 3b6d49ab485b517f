"""Plots state their units, stay finite, and keep their scale."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.collections import Collection
from matplotlib.figure import Figure

from motorprior.report.plots_motor import (
    LogPanel,
    calibration,
    closed_loop,
    excitation_and_response,
    robot_traces,
    torque_fit,
)
from motorprior.report.plots_style import png_bytes
from motorprior.report.plots_walk import footfalls, learning_curves, robustness_maps, transfer_bars
from motorprior.studies.robustness import UprightMap

TIME = np.arange(0.0, 1.0, 0.01)
ANGLE = np.sin(6.0 * TIME)
MODELS = {"paper": ANGLE + 0.1, "rollout": ANGLE * 0.99}
OWN, TWIN = {"rollout": (0.4, 1.0), "paper": (-0.1, 0.3)}, {"rollout": (0.38, 0.99), "paper": (0.1, 0.9)}
CURVES = {
    "rollout": [(np.arange(0, 50, 5), np.linspace(0, 1, 10)), (np.arange(0, 40, 4), np.linspace(0, 2, 10))],
    "paper": [(np.arange(3), np.zeros(3))],
}
RANDOM = np.random.default_rng(0)
LOG = LogPanel("log", TIME, ANGLE, ANGLE, ANGLE, ANGLE - 1, ANGLE + 1)
PUSHES = UprightMap(("push [m/s]", "friction [-]"), (0.0, 0.2), (0.5, 1.0, 2.0), [[1.0, 1.0, 1.0], [1.0, 0.5, 0.0]])
MAKERS: dict[str, Callable[[], Figure]] = {
    "excitation": lambda: excitation_and_response(TIME, ANGLE, ANGLE, ANGLE, ANGLE, ANGLE, "motor 1"),
    "excitation of angles alone": lambda: excitation_and_response(TIME, ANGLE, ANGLE, None, None, None, "motor 1"),
    "torque fit": lambda: torque_fit(TIME, ANGLE, MODELS),
    "closed loop": lambda: closed_loop(TIME, ANGLE, ANGLE, MODELS, "motor 1", band=(ANGLE - 0.1, ANGLE + 0.1)),
    "robot": lambda: robot_traces(TIME, ANGLE, MODELS, ANGLE, MODELS, "FR_knee"),
    "curves": lambda: learning_curves(CURVES),
    "transfer": lambda: transfer_bars(OWN, TWIN),
    "robustness": lambda: robustness_maps({"rollout": (PUSHES, PUSHES), "paper": (PUSHES, PUSHES)}),
    "calibration": lambda: calibration([LOG, LOG]),
}


@pytest.mark.parametrize("name", MAKERS)
def test_axes_have_units_and_finite_limits(name: str):
    figure = MAKERS[name]()
    axes = [each for each in figure.axes if each.get_label() != "<colorbar>"]
    labels = [label for each in axes for label in (each.get_xlabel(), each.get_ylabel()) if label]
    assert labels and all("[" in label and "]" in label for label in labels if label != "trained on")
    for each in axes:
        assert np.all(np.isfinite([*each.get_xlim(), *each.get_ylim()]))
    assert png_bytes(figure, dpi=40).startswith(b"\x89PNG")


def test_a_model_that_diverges_does_not_flatten_the_truth():
    wild = {"paper": ANGLE * np.exp(20 * TIME), "rollout": np.where(TIME > 0.5, np.nan, ANGLE)}
    figure = closed_loop(TIME, ANGLE, ANGLE, wild, "motor 1")
    low, high = figure.axes[0].get_ylim()
    assert np.ptp(ANGLE) <= high - low < 3 * np.ptp(ANGLE)
    labels = [str(line.get_label()) for line in figure.axes[0].lines]
    assert "paper, RMSE diverged" in labels and "rollout, RMSE diverged" in labels


def test_the_median_curve_covers_the_range_of_all_seeds():
    figure = learning_curves(CURVES)
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "rollout, 2 seeds"]
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert x[0] == 0 and x[-1] == 36
    assert y[-1] == pytest.approx((36 / 45 + 2.0) / 2)


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
    assert found[2] == [] and "60 / 100 / 0 %" in axes.get_title(loc="right")
