"""Pictures of one joint of the whole robot: simulated on each actuator model, and on the real one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.plots_motor import TIME, closed_loop
from motorprior.report.plots_style import describe, fit_y, legend_below, model_line, new_figure, panels


def robot_traces(
    time: np.ndarray,
    truth_pos: np.ndarray,
    models_pos: Mapping[str, np.ndarray],
    truth_torque: np.ndarray,
    models_torque: Mapping[str, np.ndarray],
    joint: str,
    title: str,
) -> Figure:
    """Angle and torque of one joint inside the simulated robot.

    Args:
        time: (T,) [s].
        truth_pos: (T,) [rad], the robot on physical motors.
        models_pos: (T,) [rad] per model.
        truth_torque: (T,) [N·m].
        models_torque: (T,) [N·m] per model.
        joint: its name.
        title: above the first panel.
    """
    figure = new_figure(4.4)
    angle, torque = panels(figure, 2, sharex=True, heights=(1.2, 1))[:, 0]
    model_line(angle, time, truth_pos, "physical").set_linewidth(1.9)
    model_line(torque, time, truth_torque, "physical").set_linewidth(1.6)
    for model, values in models_pos.items():
        model_line(angle, time, values, model)
    for model, values in models_torque.items():
        model_line(torque, time, values, model).set_linewidth(1.0)
    fit_y(angle, [truth_pos], list(models_pos.values()))
    fit_y(torque, [truth_torque], list(models_torque.values()))
    describe(angle, y=f"{joint} angle [rad]", title=title)
    describe(torque, x=TIME, y=f"{joint} torque [N·m]")
    legend_below(figure, angle, columns=4)
    figure.align_ylabels()
    return figure


def real_replay(
    time: np.ndarray,
    position_target: np.ndarray,
    measured: np.ndarray,
    models: Mapping[str, np.ndarray],
    band: tuple[np.ndarray, np.ndarray] | None,
    joint: str,
    title: str,
) -> Figure:
    """The commands of a real log, replayed in simulation, against what the real joint did.

    Args:
        time: (T,) [s].
        position_target: (T,) [rad].
        measured: (T,) [rad] on the real robot.
        models: (T,) [rad] per model.
        band: lower and upper end (T,) [rad] of what the sampled motors do, or None.
        joint: its name.
        title: above the first panel.
    """
    heading = f"{title} · {joint}" if joint not in title else title
    return closed_loop(time, position_target, measured, models, heading, truth_label="measured", band=band)
