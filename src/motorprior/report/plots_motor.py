"""Pictures of one motor: its commands, its response, and the responses of the actuator models."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.plots_style import (
    INK,
    MUTED,
    TEXT,
    describe,
    fit_y,
    legend_below,
    model_color,
    model_label,
    model_line,
    new_figure,
    panels,
    span,
    style,
    target_line,
    two_digits,
)
from motorprior.signals import rmse

TIME = "time [s]"
_MOST_DOTS = 1500


def excitation_and_response(
    time: np.ndarray,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray | None,
    joint_torque: np.ndarray | None,
    external_torque: np.ndarray | None,
    title: str,
) -> Figure:
    """Commands and response of a motor: angle, velocity, torque.

    Args:
        time: (T,) [s].
        position_target: (T,) [rad].
        joint_pos: (T,) [rad].
        joint_vel: (T,) [rad/s], or None if it was not recorded.
        joint_torque: (T,) of the motor on the joint [N·m], or None.
        external_torque: (T,) of everything else on the joint [N·m], or None.
        title: above the first panel.
    """
    figure = new_figure(4.6)
    angle, velocity, torque = panels(figure, 3, sharex=True, heights=(1.4, 1, 1))[:, 0]
    target_line(angle, time, position_target)
    angle.plot(time, joint_pos, color=INK, linewidth=1.2, label="joint angle")
    _optional_line(velocity, time, joint_vel, INK, "joint velocity")
    _optional_line(torque, time, external_torque, "#8a6fb3", "external torque")
    _optional_line(torque, time, joint_torque, INK, "motor torque")
    describe(angle, y="angle [rad]", title=title)
    describe(velocity, y="velocity [rad/s]")
    describe(torque, x=TIME, y="torque [N·m]")
    for axes in (angle, velocity, torque):
        _corner_legend(axes)
        if not any(np.size(line.get_xdata()) for line in axes.lines):
            axes.set_yticks([])
    figure.align_ylabels()
    return figure


def _optional_line(axes: Axes, time: np.ndarray, values: np.ndarray | None, color: str, label: str) -> None:
    if values is None:
        axes.plot([], [], color=color, linewidth=1.1, label=f"{label} (not recorded)")
    else:
        axes.plot(time, values, color=color, linewidth=1.1, label=label)


def _corner_legend(axes: Axes) -> None:
    """A legend on top of the panel's right half, outside the data."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize=TEXT - 0.5, frameon=False,
        labelcolor=MUTED, borderaxespad=0.1, handlelength=1.6,
    )  # fmt: skip


def torque_fit(time: np.ndarray, measured: np.ndarray, predicted: Mapping[str, np.ndarray]) -> Figure:
    """Predicted torque over time, and against the measured one for each model.

    Args:
        time: (T,) [s].
        measured: (T,) [N·m].
        predicted: (T,) [N·m] per model, from the recorded motion (one step ahead, not in closed loop).
    """
    figure = new_figure(4.6)
    grid = figure.add_gridspec(2, max(len(predicted), 1), height_ratios=(1.15, 1))
    trace = figure.add_subplot(grid[0, :])
    style(trace)
    model_line(trace, time, measured, "measured").set_linewidth(1.9)
    for model, values in predicted.items():
        model_line(trace, time, values, model)
    fit_y(trace, [measured], list(predicted.values()))
    describe(trace, x=TIME, y="torque [N·m]", title="Torque, one step ahead")
    limits = span([measured])
    for column, (model, values) in enumerate(predicted.items()):
        axes = figure.add_subplot(grid[1, column])
        _scatter(axes, measured, values, model, limits)
        describe(axes, x="measured [N·m]", y="predicted [N·m]" if column == 0 else None)
        axes.tick_params(labelleft=column == 0)
    legend_below(figure, trace, columns=4)
    return figure


def _scatter(axes: Axes, measured: np.ndarray, values: np.ndarray, model: str, limits: tuple[float, float]) -> None:
    """Predicted over measured [N·m], with the line where they agree."""
    style(axes)
    every = max(1, len(measured) // _MOST_DOTS)
    axes.plot(limits, limits, color=MUTED, linewidth=0.8, zorder=3)
    axes.scatter(measured[::every], values[::every], s=3, color=model_color(model), alpha=0.35, linewidths=0)
    margin = 0.08 * max(limits[1] - limits[0], 1e-6)
    bounds = (limits[0] - margin, limits[1] + margin)
    axes.set(xlim=bounds, ylim=bounds, aspect="equal")
    axes.locator_params(nbins=4)
    axes.set_title(
        f"{model_label(model)}\nRMSE {two_digits(float(rmse(values, measured)))} N·m",
        loc="left",
        fontsize=TEXT,
        color=model_color(model),
    )


def closed_loop(
    time: np.ndarray,
    position_target: np.ndarray,
    truth: np.ndarray,
    models: Mapping[str, np.ndarray],
    title: str,
    *,
    truth_label: str = "truth",
    band: tuple[np.ndarray, np.ndarray] | None = None,
) -> Figure:
    """Joint angle of each model in its own closed loop, and its error.

    Args:
        time: (T,) [s].
        position_target: (T,) [rad].
        truth: (T,) [rad].
        models: (T,) [rad] per model.
        title: above the first panel.
        truth_label: how the truth is called: a simulated motor, or a measured one.
        band: lower and upper end (T,) [rad] of what the sampled motors do, or None.
    """
    figure = new_figure(4.3)
    angle, error = panels(figure, 2, sharex=True, heights=(1.6, 1))[:, 0]
    if band is not None:
        color = model_color("rollout")
        angle.fill_between(time, *band, color=color, alpha=0.16, linewidth=0, label="sampled motors")
        error.fill_between(time, band[0] - truth, band[1] - truth, color=color, alpha=0.16, linewidth=0)
    target_line(angle, time, position_target)
    model_line(angle, time, truth, "truth", truth_label).set_linewidth(1.9)
    for model, values in models.items():
        name = f"{model_label(model)}, RMSE {_milli(float(rmse(values, truth)))}"
        model_line(angle, time, values, model, name)
        model_line(error, time, values - truth, model)
    error.axhline(0.0, color=INK, linewidth=0.8)
    fit_y(angle, [truth, position_target], list(models.values()), room=0.3)
    _fit_error(error, truth, [values - truth for values in models.values()])
    describe(angle, y="joint angle [rad]", title=title)
    describe(error, x=TIME, y="error [rad]")
    legend_below(figure, angle, columns=3)
    figure.align_ylabels()
    return figure


def _milli(value: float) -> str:
    """A root mean square angle in mrad; a model that diverged has none."""
    if not value < 10.0:
        return "diverged"
    return f"{1000 * value:.1f} mrad" if value < 0.1 else f"{1000 * value:.0f} mrad"


def _fit_error(axes: Axes, truth: np.ndarray, errors: list[np.ndarray]) -> None:
    """Symmetric limits; no wider than the truth's own range."""
    low, high = span(errors)
    most = max(high, -low, 1e-4)
    reach = max(np.ptp(truth), 1e-4) if np.all(np.isfinite(truth)) else most
    axes.set_ylim(-1.08 * min(most, reach), 1.08 * min(most, reach))
