"""Pictures of a motor prior: its latent space, and its behaviour features against those of physical motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.behaviour import behaviours
from motorprior.report.plots_style import (
    MUTED,
    TEXT,
    describe,
    legend_below,
    model_color,
    model_label,
    new_figure,
    panels,
)

UNITS = {
    "kp": "N·m/rad", "kd": "N·m·s/rad", "delay": "s", "velocity_filter": "s", "torque_limit": "N·m",
    "stall_torque": "N·m", "no_load_speed": "rad/s", "armature": "kg·m²", "coulomb": "N·m", "stribeck_torque": "N·m",
    "stribeck_velocity": "rad/s", "viscous_damping": "N·m·s/rad", "backlash": "rad", "gear_stiffness": "N·m/rad",
    "gear_damping": "N·m·s/rad", "encoder_zero": "rad",
}  # fmt: skip
LEVELS = np.linspace(0.01, 0.99, 99)


def principal_directions(network: LatentNetwork, step: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """The two directions of the latent space along which the behaviour of the decoded motors varies most.

    Principal directions of the slopes of the bench features (`bench.behaviour`) at z = 0, by central differences of
    ``step``. Each feature is divided by its standard deviation under z ~ N(0, I), to first order the norm of its row
    of slopes: latents all have variance 1, whether they change the motor or not.

    Returns:
        (Z, 2) orthonormal, Z >= 2, and (2,) the shares of the variance of all behaviour.
    """
    nudges = step * np.eye(network.num_latents)
    ahead, behind = np.split(behaviours(LatentActuator(network, np.concatenate([nudges, -nudges]))).values, 2)
    slopes = (ahead - behind).T / (2 * step)
    size = np.linalg.norm(slopes, axis=1)
    _, strength, rows = np.linalg.svd(slopes[size > 0] / size[size > 0, None])
    axes = rows[:2].T
    largest = axes[np.argmax(np.abs(axes), axis=0), np.arange(2)]
    return axes * np.where(largest < 0.0, -1.0, 1.0), strength[:2] ** 2 / np.sum(strength**2)


def best_explained(points: np.ndarray, values: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """The ``count`` of the values (M,) that are most nearly linear in points (M, D), by R², best first.

    Values that are the same for every motor are left out.
    """
    basis = np.column_stack([np.ones(len(points)), points])

    def unexplained(name: str) -> float:
        fitted = basis @ np.linalg.lstsq(basis, values[name], rcond=None)[0]
        return float(np.var(values[name] - fitted) / np.var(values[name]))

    varying = [name for name, value in values.items() if np.ptp(value) > 0]
    return {name: values[name] for name in sorted(varying, key=unexplained)[:count]}


def latent_map(points: np.ndarray, share: np.ndarray, constants: Mapping[str, np.ndarray]) -> Figure:
    """The training motors in the plane of the two principal directions, one panel per constant that colours them.

    Args:
        points: (M, 2) posterior means in that plane; circles are one and two σ of the prior.
        share: (2,) of the variance of behaviour along each direction.
        constants: name -> (M,) physical constant of each motor.
    """
    figure = new_figure(2.75 * -(-len(constants) // 2))
    grid = panels(figure, -(-len(constants) // 2), 2)
    reach = max(2.35, 1.12 * float(np.abs(points).max()))
    for axes, (name, values) in zip(grid.flat, constants.items(), strict=False):
        for radius in (1.0, 2.0):
            axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=MUTED, lw=0.8, ls="--"))
        figure.colorbar(axes.scatter(*points.T, c=values, s=22), ax=axes).ax.tick_params(labelsize=TEXT)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        first, second = (f"{100 * each:.0f} % of behaviour [-]" for each in share)
        describe(
            axes, f"1st direction: {first}", f"2nd: {second}", f"{name.replace('_', ' ')} [{UNITS.get(name, '-')}]"
        )
    for axes in grid.flat[len(constants) :]:
        axes.remove()
    return figure


def feature_quantiles(
    names: Sequence[str],
    units: Sequence[str],
    a: np.ndarray,
    b: np.ndarray,
    label_a: str,
    label_b: str,
    seed: int = 0,
) -> Figure:
    """Quantiles (1 to 99 %) of each feature of ``a`` over those of ``b``, with the identity and a 90 % band.

    On the identity: equal distributions. Shifted from it: a bias. Flatter or steeper: too small or too large a range.

    Args:
        names: F features.
        units: F units.
        a: (n, F), the vertical axis, such as samples of a prior; ``label_a`` may be a key of MODEL_COLORS.
        b: (m, F), the horizontal axis, such as held-out physical motors.
        label_a: name of a.
        label_b: name of b.
        seed: of the resampling, see `null_band`.
    """
    rows = -(-len(names) // 4)
    figure = new_figure(2.15 * rows + 0.5, width=8.8)
    grid = panels(figure, rows, 4)
    rng = np.random.default_rng(seed)
    for index, (name, unit) in enumerate(zip(names, units, strict=True)):
        axes = grid.flat[index]
        _quantile_panel(axes, a[:, index], b[:, index], label_a, rng)
        describe(axes, x=model_label(label_b), y=model_label(label_a), title=f"{name} [{unit}]")
    for axes in grid.flat[len(names) :]:
        axes.remove()
    legend_below(figure, grid[0, 0])
    return figure


def _quantile_panel(axes: Axes, a: np.ndarray, b: np.ndarray, label: str, rng: np.random.Generator) -> None:
    """One feature (n,), (m,); values of ``a`` far outside the range of ``b`` are cut off."""
    x, y = np.quantile(b, LEVELS), np.quantile(a, LEVELS)
    below, above = null_band(b, len(a), rng)
    extent = max(float(np.ptp(x)), 1e-9)
    room = max(extent, abs(float(np.median(y) - np.median(x))))
    low, high = max(min(x[0], y[0]), x[0] - room), min(max(x[-1], y[-1]), x[-1] + room)
    axes.fill_between(x, below, above, color="#cfd4da", lw=0, label="90 % of samples of equal distributions")
    axes.plot([low, high], [low, high], color=MUTED, lw=0.8, label="equal")
    axes.plot(x, y, "o", color=model_color(label), markersize=2.2, label="quantiles, 1 to 99 %")
    margin = 0.04 * max(high - low, extent)
    axes.set(xlim=(low - margin, high + margin), ylim=(low - margin, high + margin), box_aspect=1.0)


def null_band(b: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (99,) of 90 % of the quantiles of ``count`` motors of b's distribution.

    The sample b (m,) is resampled with replacement 400 times in each of the two sizes.
    """
    ours = np.quantile(rng.choice(b, (400, count)), LEVELS, axis=1)
    theirs = np.quantile(rng.choice(b, (400, len(b))), LEVELS, axis=1)
    gap = np.quantile(ours - theirs, (0.05, 0.95), axis=1)
    middle = np.quantile(b, LEVELS)
    return middle + gap[0], middle + gap[1]
