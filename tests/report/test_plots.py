"""Axes of plots have units, finite limits and a readable scale."""

from collections.abc import Callable

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.figure import Figure
from motor_logs import swinging_load

from motorprior.evaluation.free_runs import Trace
from motorprior.report import plots_style as style
from motorprior.report.plots import (
    draw_errors_by_joint,
    draw_traces,
    excitation_and_response,
    learning_curves,
)
from motorprior.report.plots_style import png_bytes
from motorprior.studies.study_settings import CONDITIONS

TIME = np.arange(0.0, 1.0, 0.01)
ANGLE = np.sin(6.0 * TIME)
TRACE = Trace("log", "knee", TIME, ANGLE, ANGLE, {"paper": ANGLE + 0.1, "rollout": ANGLE * 0.99})
CURVES = {
    "rollout": [
        (np.arange(0, 50, 5), np.linspace(0, 1, 10)),
        (np.arange(0, 40, 4), np.linspace(0, 2, 10)),
    ],
    "paper": [(np.arange(3), np.zeros(3))],
}
MAKERS: dict[str, Callable[[], Figure]] = {
    "excitation, without velocity and torque": lambda: excitation_and_response(
        swinging_load(), "motor 1"
    ),
    "traces": lambda: draw_traces([TRACE, TRACE]),
    "errors": lambda: draw_errors_by_joint(
        {"prior": {"hip": 0.01, "knee": 0.002}, "tuned_pd": {"hip": 0.03}}
    ),
    "curves": lambda: learning_curves(CURVES),
}


@pytest.mark.parametrize("name", MAKERS)
def test_axes_have_units_and_finite_limits(name: str):
    figure = MAKERS[name]()
    labels = []
    for axes in figure.axes:
        labels += [axes.get_xlabel(), axes.get_ylabel()]
        assert np.all(np.isfinite([*axes.get_xlim(), *axes.get_ylim()]))

    assert any(labels)
    assert all("[" in label and "]" in label for label in labels if label)
    assert png_bytes(figure, dpi=40).startswith(b"\x89PNG")


def test_a_model_that_diverges_does_not_flatten_the_truth():
    wild = {"paper": ANGLE * np.exp(20 * TIME), "rollout": ANGLE + 0.01}
    figure = draw_traces([Trace("log", "knee", TIME, ANGLE, ANGLE, wild)])
    low, high = figure.axes[0].get_ylim()

    assert np.ptp(ANGLE) <= high - low < 3 * np.ptp(ANGLE)


def test_the_median_curve_covers_the_range_that_all_seeds_share():
    figure = learning_curves(CURVES)
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "rollout, 2 seeds"]
    x = np.asarray(line.get_xdata())
    y = np.asarray(line.get_ydata())

    assert x[0] == 0
    assert x[-1] == 36
    assert y[-1] == pytest.approx((36 / 45 + 2.0) / 2)


# models that stand in one picture, or in the tables of one page
TOGETHER = {
    "held-out log": (
        *("adapted", "prior", "tuned_pd", "pure_delay", "second_order", "servo_limits"),
        *("per_motor", "pooled_network", "coulomb_viscous", "stribeck"),
    ),
    "study": tuple(name for name in CONDITIONS if style.model_key(name)),
}


@pytest.mark.parametrize("models", TOGETHER.values(), ids=TOGETHER)
def test_models_in_one_picture_have_colours_that_differ(models: tuple[str, ...]):
    colors = np.array([matplotlib.colors.to_rgb(style.model_color(name)) for name in models])
    distances = np.linalg.norm(colors[:, None] - colors, axis=-1)
    distances[np.diag_indices(len(models))] = np.inf
    nearest = [
        (models[row], models[column])
        for row, column in np.argwhere(distances < 0.1)
        if row < column
    ]

    assert nearest == []
