"""Quantile plots: one panel per feature with its unit, an honest band, and they survive what a model may do."""

import numpy as np

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


def test_the_band_holds_nine_of_ten_samples_of_the_same_distribution():
    rng, inside = np.random.default_rng(0), []
    for _ in range(40):
        a, b = rng.normal(size=100), rng.normal(size=150)
        below, above = null_band(b, len(a), rng)
        quantiles = np.quantile(a, np.linspace(0.01, 0.99, 99))
        inside.append(((quantiles >= below) & (quantiles <= above))[10:-10].mean())
    assert 0.82 < np.mean(inside) < 0.97
