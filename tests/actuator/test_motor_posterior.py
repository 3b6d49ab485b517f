"""The posterior of particular motors: its samples and its file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ConfigError


def made_prior() -> MotorPrior:
    box = GreyBox(np.zeros(len(PARAMETERS)), np.ones((2, len(PARAMETERS))), 0.002)
    return MotorPrior(box, np.zeros((3, 2)), np.zeros((3, 2)), "rollout", "pupper_v2", "m", {})


PRIOR = made_prior()


def posterior(motors: int) -> MotorPosterior:
    covariance = np.tile(np.array([[0.04, 0.01], [0.01, 0.09]]), (motors, 1, 1))
    mean = np.arange(2.0 * motors).reshape(motors, 2)
    names = tuple(f"joint{index}" for index in range(motors))
    return MotorPosterior(PRIOR, mean, covariance, names, 10.0, (0.5,) * motors)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_samples_have_the_posteriors_moments_and_a_share_of_the_priors(share: float):
    rng = np.random.default_rng(0)
    given = posterior(12)
    z = np.stack([given.sample(12, rng, prior_share=share).z for _ in range(4000)])
    np.testing.assert_allclose(z.mean(axis=0), given.mean, atol=0.03)
    np.testing.assert_allclose(
        np.cov(z[:, 5].T), given.covariance[5] + share**2 * np.eye(2), atol=0.02
    )


def test_a_posterior_that_is_the_prior_identifies_nothing():
    alike = replace(posterior(3), mean=np.zeros((3, 2)), covariance=np.tile(np.eye(2), (3, 1, 1)))
    known = {row.name for row in alike.constants() if row.identifiable}
    assert known <= {"delay"}  # those of this prior are at the length of the delay line
    narrow = replace(posterior(3), covariance=1e-4 * np.tile(np.eye(2), (3, 1, 1)))
    assert sum(row.identifiable is True for row in narrow.constants()) > 10


def test_a_joint_that_was_not_moved_identifies_nothing_although_its_motor_was_recorded():
    prior = replace(PRIOR, joint_names=("joint0", "joint1", "joint2"))
    still = prior.predicted(prior.joint_names).std[:, :, None] ** 2 * np.eye(2)
    alike = replace(posterior(3), prior=prior, mean=np.zeros((3, 2)), covariance=still)
    assert not any(row.identifiable for row in alike.constants())


def test_ranges_of_a_posteriors_constants_contain_the_error_of_the_model():
    row = replace(
        posterior(1), mean=np.zeros((1, 2)), covariance=1e-4 * np.eye(2)[None]
    ).constants()["kp"]
    # kp = exp(z1 + z2), with a standard deviation of 0.01 of each without that error
    assert np.log(row.high / row.low) > 1.2 * (2 * 1.645 * 0.01 * np.sqrt(2))


def test_frozen_constants_are_those_of_the_mean_motor():
    frozen, free = (prior.sample(50, 0) for prior in (PRIOR.with_frozen("friction"), PRIOR))
    assert isinstance(frozen, GreyBoxActuator) and isinstance(free, GreyBoxActuator)
    assert np.ptp(free.constants()["coulomb"]) > 0.0
    np.testing.assert_array_equal(frozen.constants()["coulomb"], np.ones(50))
    np.testing.assert_array_equal(frozen.constants()["armature"], free.constants()["armature"])
    with pytest.raises(ConfigError, match="colour"):
        PRIOR.with_frozen("colour")
    copula = Copula(np.eye(2), 0.3 + SCORES[:, None] * np.ones(2))
    moved = replace(PRIOR, model=replace(PRIOR.model, copula=copula))
    frozen = moved.with_frozen("friction").sample(2, 0)
    mean = moved.sample(2, 0, spread=0.0)
    assert isinstance(frozen, GreyBoxActuator) and isinstance(mean, GreyBoxActuator)
    np.testing.assert_allclose(frozen.constants()["coulomb"], mean.constants()["coulomb"])


def test_limits_that_follow_the_gains_are_the_central_limit_times_the_gains_share(grey_box):
    box = grey_box(spread=0.2, kp=9.0, torque_limit=1.26)
    prior = MotorPrior(box, np.zeros((3, 3)), np.zeros((3, 3)), "rollout", "pupper_v2", "m", {})
    known = MotorPosterior(
        prior, np.eye(3), np.tile(1e-6 * np.eye(3), (3, 1, 1)), ("a", "b", "c"), 10.0, (0.5,) * 3
    )
    plain, following = (known.sample(3, 0, limit_follows_gain=follows) for follows in (False, True))
    assert isinstance(plain, GreyBoxActuator) and isinstance(following, GreyBoxActuator)
    share = box.constants(plain.z)["kp"] / 9.0
    assert (
        np.abs(share - 1.0).max() > 0.1 and plain.factors is None and following.factors is not None
    )
    np.testing.assert_array_equal(following.z, plain.z)
    np.testing.assert_allclose(following.factors.torque_limit, share, rtol=1e-9)


def test_a_file_keeps_the_posterior_and_refuses_another_prior(tmp_path: Path):
    posterior(2).save(tmp_path / "p.safetensors")
    loaded = MotorPosterior.load(tmp_path / "p.safetensors", PRIOR)
    np.testing.assert_array_equal(loaded.mean, posterior(2).mean)
    np.testing.assert_array_equal(loaded.covariance, posterior(2).covariance)
    assert (loaded.joint_names, loaded.outlier_p_value, loaded.seconds) == (
        ("joint0", "joint1"),
        (0.5, 0.5),
        10.0,
    )
    with pytest.raises(ConfigError, match="another prior"):
        MotorPosterior.load(tmp_path / "p.safetensors", replace(PRIOR, preset="another"))
