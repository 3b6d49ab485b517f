"""New latents, the same motors: what they are together becomes N(0, I), and draws are like them."""

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.latents.standardise import (
    shrunk_correlation,
    standardised,
    with_scaled_spread,
)


def boxed(motors: int, seed: int = 0) -> np.ndarray:
    """(motors, 3) latents of an awkward fleet: a box, a long tail, and a narrow bell far off."""
    rng = np.random.default_rng(seed)
    parts = (
        rng.uniform(-1, 3, motors),
        np.exp(rng.standard_normal(motors)),
        5 + 0.1 * rng.standard_normal(motors),
    )
    return np.stack(parts, axis=1)


def test_every_motor_stays_what_it_is(grey_box):
    box = grey_box()
    mean = boxed(24) / 5
    new_box, new_mean, _ = standardised(box, mean)
    assert isinstance(new_box, GreyBox)
    before = box.constants(mean)
    after = new_box.constants(new_mean)
    for name, values in before.items():
        np.testing.assert_allclose(after[name], values, rtol=1e-9, atol=1e-12)


def test_correlation_is_kept_where_the_motors_show_it_and_not_where_it_is_chance():
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
    """(3·units, 3) outputs of three classes: far apart in output 0, the same in output 1, ridges in 0 and 2."""
    rng = np.random.default_rng(seed)
    centers = np.array([[-1.0, 0.2, 0.0], [0.0, 0.2, 0.3], [1.5, 0.2, -0.1]])
    ridge = rng.standard_normal((3 * units, 1)) * np.array([0.2, 0.0, -0.3])
    noise = rng.standard_normal((3 * units, 3)) * np.array([0.02, 0.1, 0.03])
    return np.tile(centers, (units, 1)) + ridge + noise, ("hip", "thigh", "calf") * units


def test_units_of_a_class_resemble_its_motors_and_not_those_of_others(grey_box):
    outputs, names = legs(200)
    box, z, classes = standardised(grey_box(latents=3), outputs, np.full(3, 0.2), names)
    np.testing.assert_allclose(box.decoder_latents(z), outputs, atol=1e-9)
    mean, std = classes.mean_and_std(("calf",) * 4000)
    draws = box.decoder_latents(mean + std * np.random.default_rng(1).standard_normal(mean.shape))
    own = outputs[2::3]
    np.testing.assert_allclose(draws.mean(axis=0), own.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.cov(draws.T), np.cov(own.T), atol=0.01)
    std = classes.mean_and_std(("tail",) * 4000)[1]
    noise = np.random.default_rng(2).standard_normal((4000, 3))
    unseen = box.decoder_latents(std * noise)
    assert unseen[:, 0].std() > 3.0 * draws[:, 0].std()


def test_equal_classes_share_their_mean(grey_box):
    outputs, names = legs(3, seed=5)
    outputs[:, 0] = 0.1 * np.random.default_rng(6).standard_normal(9)
    box, _, classes = standardised(grey_box(latents=3), outputs, np.full(3, 0.2), names)
    means = box.decoder_latents(classes.mean)
    raw = np.stack([outputs[each::3].mean(axis=0) for each in range(3)])
    assert np.ptp(means[:, 0]) < 0.5 * np.ptp(raw[:, 0]) and np.ptp(means[:, 2]) > 0.5 * np.ptp(
        raw[:, 2]
    )


@pytest.mark.parametrize("motors", [4, 40])
def test_a_limit_that_no_log_shows_is_wide_in_samples(grey_box, motors: int):
    rng = np.random.default_rng(0)
    outputs = rng.standard_normal((motors, 3))
    least = np.array([0.0, 0.7, 0.0])
    outputs[:, 1] = 2.0
    box, mean, _ = standardised(grey_box(latents=3), outputs, np.full(3, 0.1), min_std=least)
    assert np.std(box.decoder_latents(rng.standard_normal((4000, 3)))[:, 1]) == pytest.approx(
        0.7, rel=0.05
    )
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
    middle, wide_middle = (np.median(each.decoder_latents(draws), axis=0) for each in (box, wide))
    np.testing.assert_allclose(wide_middle, middle, atol=0.1)
