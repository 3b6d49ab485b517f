"""The posterior of particular motors: what it samples, and what its loader refuses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, ConfigError


def made_prior() -> MotorPrior:
    rng = np.random.default_rng(0)
    network = LatentNetwork(
        rng.normal(size=(4, 4)), rng.normal(size=(2, 4)), np.zeros(4), np.eye(4), np.zeros(4), np.ones(4),
        np.array(0.0), np.array(-6.0), np.zeros(2), (0, 1), 0.002, 0.1, 1.0, 1.0, 2.0, True,
    )  # fmt: skip
    return MotorPrior(network, np.zeros((3, 2)), np.zeros((3, 2)), "rollout", "pupper_v2", "m", {}, {})


PRIOR = made_prior()


def posterior(motors: int) -> MotorPosterior:
    covariance = np.tile(np.array([[0.04, 0.01], [0.01, 0.09]]), (motors, 1, 1))
    mean = np.arange(2.0 * motors).reshape(motors, 2)
    names = tuple(f"joint{index}" for index in range(motors))
    return MotorPosterior(PRIOR, mean, covariance, names, 10.0, (0.5,) * motors)


def test_samples_have_the_posteriors_moments():
    rng = np.random.default_rng(0)
    z = np.stack([posterior(12).sample(12, rng).z for _ in range(4000)])
    np.testing.assert_allclose(z.mean(axis=0), posterior(12).mean, atol=0.02)
    np.testing.assert_allclose(np.cov(z[:, 5].T), posterior(12).covariance[5], atol=0.01)


def test_limits_that_follow_the_gains_are_the_central_limit_times_the_gains_share(grey_network):
    network = grey_network(spread=0.2, kp=9.0, torque_limit=1.26)
    prior = MotorPrior(network, np.zeros((3, 3)), np.zeros((3, 3)), "rollout", "pupper_v2", "m", {}, {})
    known = MotorPosterior(prior, np.eye(3), np.tile(1e-6 * np.eye(3), (3, 1, 1)), ("a", "b", "c"), 10.0, (0.5,) * 3)
    plain, following = (known.sample(3, 0, limit_follows_gain=follows) for follows in (False, True))
    share = network.constants(plain.z)["kp"] / 9.0
    assert np.abs(share - 1.0).max() > 0.1 and plain.factors is None and following.factors is not None
    np.testing.assert_array_equal(following.z, plain.z)
    np.testing.assert_allclose(following.factors.torque_limit, share, rtol=1e-9)
    for others in (following.factors.kp, following.factors.kd, following.factors.coulomb):
        np.testing.assert_array_equal(others, 1.0)
    with pytest.raises(ConfigError, match="no constants, so no limit can follow"):
        posterior(1).sample(1, 0, limit_follows_gain=True)


def test_a_round_trip_is_exact(tmp_path: Path):
    posterior(2).save(tmp_path / "p.safetensors")
    loaded = MotorPosterior.load(tmp_path / "p.safetensors", PRIOR)
    np.testing.assert_array_equal(loaded.mean, posterior(2).mean)
    np.testing.assert_array_equal(loaded.covariance, posterior(2).covariance)
    assert (loaded.joint_names, loaded.surprise, loaded.seconds) == (("joint0", "joint1"), (0.5, 0.5), 10.0)


@pytest.mark.parametrize(
    ("tensors", "header", "word"),
    [
        ({}, {"kind": "motor prior"}, "motor prior"),
        ({}, {"schema_version": 1}, "schema"),
        ({}, {"extra": 1}, "extra"),
        ({"covariance": np.zeros((2, 2, 2))}, {}, "positive definite"),
        ({"covariance": np.eye(2)}, {}, r"covariance is float64\(2, 2\), wanted float64\(2, 2, 2\)"),
        ({}, {"joint_names": ["one"]}, r"mean is float64\(2, 2\), wanted float64\(1, 2\)"),
        ({}, {"surprise": [0.5]}, "not as many"),
    ],
)
def test_a_loader_refuses_what_does_not_fit(tmp_path: Path, tensors: dict, header: dict, word: str):
    path = tmp_path / "p.safetensors"
    posterior(2).save(path)
    good_tensors, good_header = read_tensors(path)
    write_tensors(path, good_tensors | tensors, good_header | header)
    with pytest.raises(ArtifactError, match=word):
        MotorPosterior.load(path, PRIOR)


def test_a_posterior_of_another_prior_is_refused(tmp_path: Path):
    posterior(2).save(tmp_path / "p.safetensors")
    with pytest.raises(ConfigError, match="no posterior of this prior"):
        MotorPosterior.load(tmp_path / "p.safetensors", replace(PRIOR, preset="another"))


def nearly_singular(rng: np.random.Generator) -> np.ndarray:
    """(2, 2) of rank one but for its last bits; of many, some have eigenvalues above 0 and yet no Cholesky factor."""
    a, ratio = rng.uniform(0.01, 1.0), rng.uniform(0.1, 10.0)
    return a * np.array([[1.0, ratio], [ratio, ratio**2 * (1 + rng.uniform(-3e-16, 3e-16))]])


def test_a_covariance_that_loads_can_be_drawn_from(tmp_path: Path):
    path, rng, refusals = tmp_path / "p.safetensors", np.random.default_rng(0), 0
    for _ in range(300):
        replace(posterior(1), covariance=nearly_singular(rng)[None]).save(path)
        try:
            loaded = MotorPosterior.load(path, PRIOR)
        except ArtifactError as error:
            assert "positive definite" in error.problem and error.where == path and error.remedy
            refusals += 1
        else:
            assert np.all(np.isfinite(loaded.sample(12, rng).z))
    assert 0 < refusals < 300
