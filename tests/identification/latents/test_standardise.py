"""Standardised latents are N(0, I); they describe the same motors, and samples resemble them."""

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.latents.standardise import (
    shrunk_correlation,
    standardised,
    with_scaled_spread,
)


def boxed(motors: int, seed: int = 0) -> np.ndarray:
    """(motors, 3) latents: uniform, with a long tail, and narrow around a distant mean."""
    rng = np.random.default_rng(seed)
    uniform = rng.uniform(-1, 3, motors)
    long_tail = np.exp(rng.standard_normal(motors))
    narrow = 5 + 0.1 * rng.standard_normal(motors)
    return np.stack([uniform, long_tail, narrow], axis=1)


def test_standardised_latents_describe_the_same_motors(grey_box):
    box = grey_box()
    mean = boxed(24) / 5
    new_box, new_mean, _ = standardised(box, mean)
    assert isinstance(new_box, GreyBox)
    constants = box.constants(mean)
    new_constants = new_box.constants(new_mean)

    for name, values in constants.items():
        np.testing.assert_allclose(new_constants[name], values, rtol=1e-9, atol=1e-12)


def test_a_significant_correlation_is_kept_and_a_chance_one_shrinks():
    rng = np.random.default_rng(3)
    factor = np.linalg.cholesky(np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    many = shrunk_correlation(rng.standard_normal((500, 3)) @ factor.T)

    np.testing.assert_allclose(many, factor @ factor.T, atol=0.12)

    few = rng.standard_normal((24, 14))
    shrunk = shrunk_correlation(few) - np.eye(14)
    chance = np.asarray(np.corrcoef(few.T)) - np.eye(14)

    assert np.abs(shrunk).max() < 0.35 * np.abs(chance).max()
    assert np.linalg.eigvalsh(shrunk + np.eye(14)).min() > 0


def legs(units: int, seed: int = 0) -> tuple[np.ndarray, tuple[str, ...]]:
    """(3·units, 3) outputs and class names of the motors of three classes.

    Classes are far apart in output 0 and equal in output 1; outputs 0 and 2 are correlated.
    """
    rng = np.random.default_rng(seed)
    centers = np.array([[-1.0, 0.2, 0.0], [0.0, 0.2, 0.3], [1.5, 0.2, -0.1]])
    ridge = rng.standard_normal((3 * units, 1)) * np.array([0.2, 0.0, -0.3])
    noise = rng.standard_normal((3 * units, 3)) * np.array([0.02, 0.1, 0.03])

    return np.tile(centers, (units, 1)) + ridge + noise, ("hip", "thigh", "calf") * units


def test_samples_of_a_class_resemble_its_motors(grey_box):
    outputs, names = legs(200)
    box, z, classes = standardised(grey_box(latents=3), outputs, np.full(3, 0.2), names)

    np.testing.assert_allclose(box.decoder_latents(z), outputs, atol=1e-9)

    mean, std = classes.mean_and_std(("calf",) * 4000)
    draws = box.decoder_latents(mean + std * np.random.default_rng(1).standard_normal(mean.shape))
    calves = outputs[2::3]

    np.testing.assert_allclose(draws.mean(axis=0), calves.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.cov(draws.T), np.cov(calves.T), atol=0.01)

    # samples of an unknown class vary like all motors
    std = classes.mean_and_std(("tail",) * 4000)[1]
    noise = np.random.default_rng(2).standard_normal((4000, 3))
    unseen = box.decoder_latents(std * noise)

    assert unseen[:, 0].std() > 3.0 * draws[:, 0].std()


def test_equal_classes_share_their_mean(grey_box):
    outputs, names = legs(3, seed=5)
    outputs[:, 0] = 0.1 * np.random.default_rng(6).standard_normal(9)
    box, _, classes = standardised(grey_box(latents=3), outputs, np.full(3, 0.2), names)
    means = box.decoder_latents(classes.mean)
    raw = np.stack([outputs[first::3].mean(axis=0) for first in range(3)])

    # classes are equal in output 0, and differ in output 2
    assert np.ptp(means[:, 0]) < 0.5 * np.ptp(raw[:, 0])
    assert np.ptp(means[:, 2]) > 0.5 * np.ptp(raw[:, 2])


@pytest.mark.parametrize("motors", [4, 40])
def test_samples_of_an_unidentified_limit_have_the_minimum_standard_deviation(
    grey_box, motors: int
):
    rng = np.random.default_rng(0)
    outputs = rng.standard_normal((motors, 3))
    min_std = np.array([0.0, 0.7, 0.0])
    outputs[:, 1] = 2.0
    box, mean, _ = standardised(grey_box(latents=3), outputs, np.full(3, 0.1), min_std=min_std)

    samples = box.decoder_latents(rng.standard_normal((4000, 3)))
    assert np.std(samples[:, 1]) == pytest.approx(0.7, rel=0.05)
    np.testing.assert_allclose(box.decoder_latents(mean), outputs)


def test_a_scaled_prior_has_the_same_motors_and_a_larger_standard_deviation(grey_box):
    rng = np.random.default_rng(0)
    box, mean, classes = standardised(grey_box(latents=3), rng.standard_normal((40, 3)))
    wide, moved, log_var, _ = with_scaled_spread(box, mean, np.zeros_like(mean), classes, 1.5)

    np.testing.assert_allclose(log_var, -2.0 * np.log(1.5))
    np.testing.assert_allclose(wide.decoder_latents(moved), box.decoder_latents(mean), atol=1e-9)

    draws = rng.standard_normal((2000, 3))
    spread = wide.decoder_latents(draws).std(axis=0) / box.decoder_latents(draws).std(axis=0)

    np.testing.assert_allclose(spread, 1.5, rtol=0.02)

    middle = np.median(box.decoder_latents(draws), axis=0)
    wide_middle = np.median(wide.decoder_latents(draws), axis=0)

    np.testing.assert_allclose(wide_middle, middle, atol=0.1)
