"""Quantile plots: one panel per feature with its unit, an honest band, and they survive what a model may do."""

import numpy as np
import pytest

from motorprior.report.plots_distribution import feature_quantiles, null_band
from motorprior.report.plots_style import png_bytes

NAMES, UNITS = ("gain 1 Hz", "rise time", "dead band", "breakaway", "peak speed"), ("-", "s", "rad", "N·m", "rad/s")


def sample(seed: int, count: int = 80) -> np.ndarray:
    return np.random.default_rng(seed).normal(1.0, 0.1, (count, len(NAMES)))


def panels(figure):
    return [axes for axes in figure.axes if axes.axison]


def test_every_feature_has_a_panel_with_its_unit_and_equal_axes():
    figure = feature_quantiles(NAMES, UNITS, sample(0), sample(1), "rollout", "physical")
    titles = [axes.get_title(loc="left") for axes in panels(figure)]
    assert titles == [f"{name} [{unit}]" for name, unit in zip(NAMES, UNITS, strict=True)]
    assert all(axes.get_xlim() == axes.get_ylim() for axes in panels(figure))
    assert png_bytes(figure, dpi=60)[:4] == b"\x89PNG"


@pytest.mark.parametrize("case", ["far", "constant", "wide", "both constant"])
def test_what_a_model_may_do_stays_in_the_picture(case):
    a, b = sample(2), sample(3)
    if case == "far":
        a[:, 0] += 50.0
    if case == "wide":
        a[:, 0] = np.linspace(-1e6, 1e6, len(a))
    if "constant" in case:
        a[:, 0] = 1.0
    if case == "both constant":
        b[:, 0] = 1.0
    figure = feature_quantiles(NAMES, UNITS, a, b, "prior draws", "physical motors")
    axes = panels(figure)[0]
    low, high = axes.get_ylim()
    assert np.isfinite([low, high]).all() and high > low
    points = np.concatenate([line.get_ydata() for line in axes.lines[1:]])
    assert len(points) == 99 and points.min() >= low and points.max() <= high
    png_bytes(figure, dpi=40)


def test_the_band_holds_nine_of_ten_samples_of_the_same_distribution():
    rng, inside = np.random.default_rng(0), []
    for _ in range(40):
        a, b = rng.normal(size=100), rng.normal(size=150)
        below, above = null_band(b, len(a), rng)
        quantiles = np.quantile(a, np.linspace(0.01, 0.99, 99))
        inside.append(((quantiles >= below) & (quantiles <= above))[10:-10].mean())
    assert 0.82 < np.mean(inside) < 0.97


def test_same_seed_same_picture():
    one, other = (feature_quantiles(NAMES, UNITS, sample(4), sample(5), "paper", "physical") for _ in range(2))
    assert png_bytes(one, dpi=50) == png_bytes(other, dpi=50)
