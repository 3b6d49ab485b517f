"""Picture of one motor of a real log with the bands of samples of a prior."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.plots_style import INK, describe, legend_below, model_color, new_figure, panels, target_line
from motorprior.signals import rmse

_OPACITY = {50: 0.34, 90: 0.18}


def log_against_bands(
    time: np.ndarray,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    model: np.ndarray,
    bands: Mapping[int, tuple[np.ndarray, np.ndarray]],
    title: str,
) -> Figure:
    """Free run of one motor over a whole log: angle and error, with bands.

    Args:
        time: (T,) [s].
        position_target: (T,) [rad].
        joint_pos: (T,) recorded [rad].
        model: (T,) simulated with the adapted prior [rad].
        bands: level [%] -> lower and upper bound (T,) [rad] over samples of motors.
        title: of the figure.
    """
    figure, color = new_figure(4.3), model_color("rollout")
    angle, error = panels(figure, 2, sharex=True, heights=(1.4, 1))[:, 0]
    target_line(angle, time, position_target).set_linewidth(0.5)
    for level, (low, high) in sorted(bands.items(), reverse=True):
        inside = np.mean((joint_pos >= low) & (joint_pos <= high))
        style = {"color": color, "alpha": _OPACITY.get(level, 0.2), "linewidth": 0}
        angle.fill_between(time, low, high, label=f"{level} % band, holds {100 * inside:.0f} %", **style)
        error.fill_between(time, low - joint_pos, high - joint_pos, **style)
    angle.plot(time, joint_pos, color=INK, linewidth=1.1, label="recorded")
    name = f"prior, adapted: RMSE {1e3 * float(rmse(model, joint_pos)):.1f} mrad"
    angle.plot(time, model, color=color, linewidth=0.9, label=name)
    error.plot(time, model - joint_pos, color=color, linewidth=0.9)
    error.axhline(0.0, color=INK, linewidth=0.8)
    describe(angle, y="joint angle [rad]", title=title)
    describe(error, x="time [s]", y="simulated - recorded [rad]")
    legend_below(figure, angle, columns=3)
    figure.align_ylabels()
    return figure
