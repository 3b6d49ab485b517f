"""A prior's file is what was saved, and a loader refuses what it does not understand."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError


@pytest.fixture(params=["grey box", "network"])
def prior(request: pytest.FixtureRequest, grey_network: Callable[..., LatentNetwork]) -> MotorPrior:
    network = grey_network(network=0.5, encoder_zero=-0.02)
    if request.param == "network":
        network = replace(network, motor=None, has_armature=True)
    rng = np.random.default_rng(0)
    mean, log_var = rng.standard_normal((5, 3)), rng.uniform(-4, 0, (5, 3))
    return MotorPrior(network, mean, log_var, "rollout", "pupper_v2", "m", {"seed": 3}, {"final_loss": 0.5})


@pytest.fixture
def saved(prior: MotorPrior, tmp_path: Path) -> Path:
    path = tmp_path / "prior.safetensors"
    prior.save(path)
    return path


@pytest.fixture
def gain_scaled(grey_network: Callable[..., LatentNetwork]) -> MotorPrior:
    """A prior of motors with logged gains."""
    network, mean = replace(grey_network(), gain_unit="N·m/rad"), np.random.default_rng(1).standard_normal((3, 3))
    gains = np.array([[20.0, 20.0, 40.0], [1.0, 1.5, 2.0]])
    return MotorPrior(network, mean, mean, "rollout", "go2", "m", {}, {}, ("hip", "thigh", "calf"), gains)


def test_a_prior_keeps_joint_names_and_logged_gains(gain_scaled: MotorPrior, tmp_path: Path):
    gain_scaled.save(tmp_path / "p.safetensors")
    prior = MotorPrior.load(tmp_path / "p.safetensors")
    assert prior.joint_names == gain_scaled.joint_names and prior.network.gain_unit == "N·m/rad"
    np.testing.assert_array_equal(prior.gains, gain_scaled.gains)
    np.testing.assert_array_equal(prior.training_motors(np.array([2])).gains, [[40.0], [2.0]])
    np.testing.assert_array_equal(prior.sample(2, 0).gains, [[20.0, 20.0], [1.5, 1.5]])
    np.testing.assert_array_equal(prior.sample(2, 0, np.ones((2, 2))).gains, np.ones((2, 2)))
    np.testing.assert_array_equal(prior.expected(("calf", "tail")), [gain_scaled.mean[2], np.zeros(3)])


def rewrite(path: Path, tensors: dict, header: dict, without: tuple[str, ...] = ()) -> None:
    """Change some tensors and header keys of a file, and drop others."""
    old_tensors, old_header = read_tensors(path)
    both = (old_tensors | tensors, old_header | header)
    write_tensors(path, *({key: value for key, value in one.items() if key not in without} for one in both))


def test_what_is_saved_is_loaded(prior: MotorPrior, saved: Path):
    loaded = MotorPrior.load(saved)
    names = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
    for name in (*names, "taps", "period", "error_scale", "velocity_scale", "torque_scale", "torque_limit"):
        np.testing.assert_array_equal(getattr(loaded.network, name), getattr(prior.network, name))
    for name in ("mean", "log_var"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(prior, name))
    texts = ("preset", "robot", "motor", "provenance", "metrics")
    assert [getattr(loaded, name) for name in texts] == [getattr(prior, name) for name in texts]
    assert (loaded.network.motor is None) == (prior.network.motor is None)
    if prior.network.motor is not None and loaded.network.motor is not None:
        np.testing.assert_array_equal(loaded.network.motor.center, prior.network.motor.center)
        np.testing.assert_array_equal(loaded.network.motor.slope, prior.network.motor.slope)


def test_the_same_prior_gives_the_same_bytes(prior: MotorPrior, saved: Path, tmp_path: Path):
    MotorPrior.load(saved).save(tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == saved.read_bytes()
    assert prior.sha256() == hashlib.sha256(saved.read_bytes()).hexdigest()


@pytest.mark.parametrize("prior", ["grey box"], indirect=True)
@pytest.mark.parametrize(
    ("tensors", "header", "without"),
    [
        ({}, {}, ("motor_center",)),
        ({"motor_curve": np.zeros(3)}, {}, ()),
        ({}, {"motor_terms": ["heat"]}, ()),
        ({"motor_slope": np.zeros((14, 3))}, {}, ()),
        ({"motor_center": np.full(14, np.nan)}, {}, ()),
        ({}, {"taps": [0, 5, 2]}, ()),
        ({}, {"schema_version": 1}, ()),
    ],
)
def test_a_file_that_is_no_prior_is_rejected_by_name(
    saved: Path, tensors: dict, header: dict, without: tuple[str, ...]
):
    rewrite(saved, tensors, header, without)
    with pytest.raises(ArtifactError, match=saved.name):
        MotorPrior.load(saved)
