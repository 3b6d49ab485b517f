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
    motors = posterior(12)
    z = np.stack([motors.sample(12, rng, prior_share=share).z for _ in range(4000)])

    np.testing.assert_allclose(z.mean(axis=0), motors.mean, atol=0.03)
    np.testing.assert_allclose(
        np.cov(z[:, 5].T), motors.covariance[5] + share**2 * np.eye(2), atol=0.02
    )


def test_a_posterior_equal_to_the_prior_identifies_nothing():
    alike = replace(posterior(3), mean=np.zeros((3, 2)), covariance=np.tile(np.eye(2), (3, 1, 1)))
    identifiable = {row.name for row in alike.constants() if row.identifiable}

    # delays of this prior's motors are at the length of the delay line
    assert identifiable <= {"delay"}


def test_a_narrow_posterior_identifies_constants():
    narrow = replace(posterior(3), covariance=1e-4 * np.tile(np.eye(2), (3, 1, 1)))

    assert sum(row.identifiable is True for row in narrow.constants()) > 10


def test_a_static_joint_identifies_nothing_although_the_prior_knows_its_motor():
    prior = replace(PRIOR, joint_names=("joint0", "joint1", "joint2"))
    still = prior.predicted(prior.joint_names).std[:, :, None] ** 2 * np.eye(2)
    alike = replace(posterior(3), prior=prior, mean=np.zeros((3, 2)), covariance=still)
    assert not any(row.identifiable for row in alike.constants())


def test_ranges_of_a_posteriors_constants_contain_the_error_of_the_model():
    narrow = replace(posterior(1), mean=np.zeros((1, 2)), covariance=1e-4 * np.eye(2)[None])

    estimate = narrow.constants()["kp"].estimate

    # kp = exp(z1 + z2). Without that error, the standard deviation of either latent is 0.01, and
    # 90 % of the samples lie within 1.645 standard deviations of their sum.
    range_without_error = 2 * 1.645 * 0.01 * np.sqrt(2)
    assert estimate is not None
    assert np.log(estimate.high / estimate.low) > 1.2 * range_without_error


def test_frozen_constants_are_those_of_the_mean_motor():
    frozen = PRIOR.with_frozen("friction").sample(50, 0)
    free = PRIOR.sample(50, 0)

    assert isinstance(frozen, GreyBoxActuator)
    assert isinstance(free, GreyBoxActuator)
    assert np.ptp(free.constants()["coulomb"]) > 0.0
    np.testing.assert_array_equal(frozen.constants()["coulomb"], np.ones(50))
    np.testing.assert_array_equal(frozen.constants()["armature"], free.constants()["armature"])


def test_frozen_constants_with_a_copula_are_those_of_the_mean_motor():
    copula = Copula(np.eye(2), 0.3 + SCORES[:, None] * np.ones(2))
    moved = replace(PRIOR, model=replace(PRIOR.model, copula=copula))
    frozen = moved.with_frozen("friction").sample(2, 0)
    mean = moved.sample(2, 0, spread=0.0)

    assert isinstance(frozen, GreyBoxActuator)
    assert isinstance(mean, GreyBoxActuator)
    np.testing.assert_allclose(frozen.constants()["coulomb"], mean.constants()["coulomb"])


def test_an_unknown_group_of_constants_is_named():
    with pytest.raises(ConfigError, match="colour"):
        PRIOR.with_frozen("colour")


def test_limits_that_follow_the_gains_scale_with_kp(grey_box):
    box = grey_box(spread=0.2, kp=9.0, torque_limit=1.26)
    prior = MotorPrior(box, np.zeros((3, 3)), np.zeros((3, 3)), "rollout", "pupper_v2", "m", {})
    covariance = np.tile(1e-6 * np.eye(3), (3, 1, 1))
    narrow = MotorPosterior(prior, np.eye(3), covariance, ("a", "b", "c"), 10.0, (0.5,) * 3)

    plain = narrow.sample(3, 0, limit_follows_gain=False)
    following = narrow.sample(3, 0, limit_follows_gain=True)

    assert isinstance(plain, GreyBoxActuator)
    assert isinstance(following, GreyBoxActuator)
    share = box.constants(plain.z)["kp"] / 9.0
    assert np.abs(share - 1.0).max() > 0.1
    assert plain.factors is None
    assert following.factors is not None
    np.testing.assert_array_equal(following.z, plain.z)
    np.testing.assert_allclose(following.factors.torque_limit, share, rtol=1e-9)


def test_a_loaded_posterior_equals_the_saved_one(tmp_path: Path):
    path = tmp_path / "p.safetensors"
    posterior(2).save(path)

    loaded = MotorPosterior.load(path, PRIOR)

    np.testing.assert_array_equal(loaded.mean, posterior(2).mean)
    np.testing.assert_array_equal(loaded.covariance, posterior(2).covariance)
    assert loaded.joint_names == ("joint0", "joint1")
    assert loaded.outlier_p_value == (0.5, 0.5)
    assert loaded.seconds == 10.0


def test_a_posterior_of_another_prior_is_rejected(tmp_path: Path):
    path = tmp_path / "p.safetensors"
    posterior(2).save(path)

    with pytest.raises(ConfigError) as refusal:
        MotorPosterior.load(path, replace(PRIOR, preset="another"))

    assert refusal.value.where == path
