"""Picture of the latent space: the training motors, coloured by their physical parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from motorprior.report.latent_directions import Directions
from motorprior.report.plots_style import INK, MUTED, TEXT, describe, new_figure, panels, style

PARAMETER_LABELS = {
    "kp": "position gain [N·m/rad]",
    "kd": "velocity gain [N·m·s/rad]",
    "delay": "delay [s]",
    "velocity_filter": "velocity filter [s]",
    "torque_limit": "torque limit [N·m]",
    "stall_torque": "stall torque [N·m]",
    "no_load_speed": "no-load speed [rad/s]",
    "armature": "armature [kg·m²]",
    "coulomb": "Coulomb friction [N·m]",
    "stribeck_torque": "Stribeck torque [N·m]",
    "stribeck_velocity": "Stribeck velocity [rad/s]",
    "viscous_damping": "viscous damping [N·m·s/rad]",
    "load_friction": "load friction [-]",
    "backlash": "backlash [rad]",
    "gear_stiffness": "gear stiffness [N·m/rad]",
    "gear_damping": "gear damping [N·m·s/rad]",
    "encoder_zero": "encoder zero [rad]",
}
_COLUMNS = 2


def latent_map(
    mean: np.ndarray, log_var: np.ndarray, parameters: Mapping[str, np.ndarray], directions: Directions | None
) -> Figure:
    """The training motors in the latent space, coloured by their physical parameters.

    Two latents or more: orthogonal projection onto the plane of the two directions through the origin, in which the
    prior is N(0, I) too; ellipses are one posterior σ, circles one and two σ of the prior. One latent: each parameter
    over it. None: a note.

    Args:
        mean: (M, Z) posterior means.
        log_var: (M, Z) their log variances.
        parameters: (M,) of each physical parameter, by its name in `MotorParameters`.
        directions: those that matter most (`behaviour_directions`); not needed below two latents.
    """
    if mean.shape[1] == 0:
        return _note("No latents: one and the same network stands for every motor.")
    rows = -(-len(parameters) // _COLUMNS)
    if not rows:
        parameters, rows = {"": np.zeros(len(mean))}, 1
    figure = new_figure((2.5 if mean.shape[1] == 1 else 2.75) * rows, layout="compressed")
    grid = panels(figure, rows, _COLUMNS if len(parameters) > 1 else 1)
    for axes, (name, values) in zip(grid.flat, parameters.items(), strict=False):
        label = PARAMETER_LABELS.get(name, name.replace("_", " "))
        if directions is None:
            _along_one_latent(axes, mean[:, 0], log_var[:, 0], values, label)
        else:
            _on_the_plane(figure, axes, mean, log_var, values, label, directions)
    for axes in grid.flat[len(parameters) :]:
        axes.remove()
    return figure


def _on_the_plane(
    figure: Figure,
    axes: Axes,
    mean: np.ndarray,
    log_var: np.ndarray,
    values: np.ndarray,
    label: str,
    directions: Directions,
) -> None:
    """One panel: prior, posterior ellipses, means coloured by ``values``."""
    points = mean @ directions.axes
    for radius in (1.0, 2.0):
        dashed = {"edgecolor": MUTED, "linewidth": 0.8, "linestyle": (0, (3, 2))}
        axes.add_patch(Circle((0, 0), radius, fill=False, **dashed))
        _sigma_label(axes, radius)
    _ellipses(axes, points, log_var, directions.axes)
    look = {"cmap": "viridis", "s": 26, "edgecolors": "white", "linewidths": 0.5, "zorder": 3}
    dots = axes.scatter(*points.T, c=values, **look)
    reach = max(2.35, 1.12 * float(np.abs(points).max()))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    if label:
        _colorbar(figure, axes, dots)
    first, second = (f"{100 * share:.0f} % of behaviour [-]" for share in directions.share)
    describe(axes, x=f"latent, 1st direction: {first}", y=f"2nd direction: {second}")
    axes.set_title(label, loc="left", fontsize=TEXT + 0.5, color=INK)
    axes.locator_params(nbins=6)


def _ellipses(axes: Axes, points: np.ndarray, log_var: np.ndarray, directions: np.ndarray) -> None:
    """One-σ ellipse of each posterior, projected onto the plane: covariance Wᵀ diag(exp(log_var)) W."""
    covariance = np.einsum("zi,mz,zj->mij", directions, np.exp(log_var), directions)
    variance, axis = np.linalg.eigh(covariance)
    sigma = np.sqrt(variance)
    angle = np.degrees(np.arctan2(axis[:, 1, 1], axis[:, 0, 1]))
    axes.add_collection(
        EllipseCollection(
            2 * sigma[:, 1], 2 * sigma[:, 0], angle, units="xy", offsets=points,
            offset_transform=axes.transData, facecolors="#5b64701c", edgecolors="#5b647060", linewidths=0.5,
        )
    )  # fmt: skip


def _sigma_label(axes: Axes, radius: float) -> None:
    """Names a circle at its lower right, legible over dots."""
    at = radius * np.sqrt(0.5)
    box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    look = {"fontsize": TEXT - 1.5, "ha": "center", "va": "center", "zorder": 4, "bbox": box}
    axes.text(at, -at, f"{radius:.0f}σ", color=MUTED, **look)


def _colorbar(figure: Figure, axes: Axes, dots: PathCollection) -> None:
    bar = figure.colorbar(dots, ax=axes, shrink=0.92, pad=0.03, aspect=24)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.ax.tick_params(labelsize=TEXT - 1, labelcolor=MUTED, width=0.6, length=2)
    bar.ax.locator_params(nbins=5)


def _along_one_latent(axes: Axes, mean: np.ndarray, log_var: np.ndarray, values: np.ndarray, label: str) -> None:
    """One panel: the parameter over the only latent, with the prior's one and two σ shaded."""
    for radius in (2.0, 1.0):
        axes.axvspan(-radius, radius, color=MUTED, alpha=0.07, linewidth=0)
    axes.errorbar(
        mean, values, xerr=np.exp(0.5 * log_var), fmt="o", markersize=3.5, color=INK, ecolor="#5b647080",
        elinewidth=0.8,
    )  # fmt: skip
    reach = max(2.35, 1.12 * float(np.abs(mean).max()))
    axes.set_xlim(-reach, reach)
    describe(axes, x="latent [-]", y=label or "motor [-]")


def _note(text: str) -> Figure:
    """A figure with a text in place of a plot."""
    figure = new_figure(1.0)
    axes = figure.add_subplot()
    style(axes)
    axes.set_axis_off()
    axes.text(0.0, 0.5, text, ha="left", va="center", fontsize=TEXT + 1, color=MUTED)
    return figure
