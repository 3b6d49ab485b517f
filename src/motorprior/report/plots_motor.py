"""Pictures of motors: commands and response, and the responses of actuator models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.plots_style import (
    INK,
    TIME,
    describe,
    fit_y,
    legend_below,
    model_color,
    model_label,
    model_line,
    new_figure,
    panels,
    span,
    target_line,
)
from motorprior.signals import rmse


def excitation_and_response(
    time: np.ndarray,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray | None,
    joint_torque: np.ndarray | None,
    external_torque: np.ndarray | None,
    title: str,
) -> Figure:
    """Commands and response of a motor: (T,) angles, velocity and torques in SI units; None if not recorded."""
    figure = new_figure(4.6)
    angle, velocity, torque = panels(figure, 3, sharex=True, heights=(1.4, 1, 1))[:, 0]
    target_line(angle, time, position_target)
    angle.plot(time, joint_pos, color=INK, lw=1.2, label="joint angle")
    for axes, values, color, label in (
        (velocity, joint_vel, INK, "joint velocity"),
        (torque, external_torque, "#8a6fb3", "external torque"),
        (torque, joint_torque, INK, "motor torque"),
    ):
        if values is not None:
            axes.plot(time, values, color=color, lw=1.1, label=label)
    describe(angle, y="angle [rad]", title=title)
    describe(velocity, y="velocity [rad/s]")
    describe(torque, x=TIME, y="torque [N·m]")
    legend_below(figure, (angle, velocity, torque))
    return figure


def torque_fit(time: np.ndarray, measured: np.ndarray, predicted: Mapping[str, np.ndarray]) -> Figure:
    """Measured (T,) torque [N·m] and the torque that models predict one step ahead from the recorded motion."""
    figure = new_figure(2.6)
    (axes,) = panels(figure, 1)[0]
    model_line(axes, time, measured, "measured").set_linewidth(1.9)
    for model, values in predicted.items():
        label = f"{model_label(model)}, RMSE {float(rmse(values, measured)):.2g} N·m"
        model_line(axes, time, values, model, label)
    fit_y(axes, [measured], list(predicted.values()))
    describe(axes, x=TIME, y="torque [N·m]", title="Torque, one step ahead")
    legend_below(figure, axes)
    return figure


def closed_loop(
    time: np.ndarray,
    position_target: np.ndarray,
    truth: np.ndarray,
    models: Mapping[str, np.ndarray],
    title: str,
    *,
    truth_label: str = "truth",
    band: Sequence[np.ndarray] = (),
) -> Figure:
    """Joint angle (T,) [rad] of each model in its own closed loop, and its error.

    Args:
        time: (T,) [s].
        position_target: (T,) [rad].
        truth: (T,) [rad], of a simulated or measured motor.
        models: (T,) [rad] per model.
        title: of the figure.
        truth_label: for the legend.
        band: lower and upper bound (T,) [rad] of the sampled motors, if there are any.
    """
    figure = new_figure(4.3)
    angle, error = panels(figure, 2, sharex=True, heights=(1.6, 1))[:, 0]
    if band:
        for axes, zero in ((angle, 0.0), (error, truth)):
            low, high = (edge - zero for edge in band)
            axes.fill_between(time, low, high, color=model_color("rollout"), alpha=0.16, lw=0, label="sampled motors")
    target_line(angle, time, position_target)
    model_line(angle, time, truth, "truth", truth_label).set_linewidth(1.9)
    for model, values in models.items():
        model_line(angle, time, values, model, f"{model_label(model)}, RMSE {_milli(float(rmse(values, truth)))}")
        model_line(error, time, values - truth, model)
    fit_y(angle, [truth, position_target], list(models.values()), margin=0.3)
    low, high = span([values - truth for values in models.values()])
    reach = 1.08 * min(max(high, -low, 1e-4), max(float(np.ptp(truth)), 1e-4))
    error.set_ylim(-reach, reach)
    describe(angle, y="joint angle [rad]", title=title)
    describe(error, x=TIME, y="error [rad]")
    legend_below(figure, angle, columns=2)
    return figure


def _milli(value: float) -> str:
    """An RMSE in mrad, or "diverged"."""
    return f"{1000 * value:.3g} mrad" if value < 10.0 else "diverged"


def robot_traces(
    time: np.ndarray,
    truth_pos: np.ndarray,
    models_pos: Mapping[str, np.ndarray],
    truth_torque: np.ndarray,
    models_torque: Mapping[str, np.ndarray],
    title: str,
) -> Figure:
    """(T,) angle [rad] and torque [N·m] of one joint of the simulated robot, on physical motors and on each model."""
    figure = new_figure(4.4)
    angle, torque = panels(figure, 2, sharex=True, heights=(1.2, 1))[:, 0]
    for axes, truth, models in ((angle, truth_pos, models_pos), (torque, truth_torque, models_torque)):
        model_line(axes, time, truth, "physical").set_linewidth(1.9)
        for model, values in models.items():
            model_line(axes, time, values, model).set_linewidth(1.0)
        fit_y(axes, [truth], list(models.values()))
    describe(angle, y="angle [rad]", title=title)
    describe(torque, x=TIME, y="torque [N·m]")
    legend_below(figure, angle)
    return figure
