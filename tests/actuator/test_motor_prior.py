"""A prior's file is what was saved, and a loader refuses what it does not understand."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import jax
import numpy as np
import pytest

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError


@pytest.fixture(params=["grey box", "network"])
def prior(request: pytest.FixtureRequest, grey_box: Callable[..., GreyBox]) -> MotorPrior:
    rng = np.random.default_rng(0)
    if request.param == "network":
        model = LatentNetwork(
            w1=rng.standard_normal((4, 8)), v1=rng.standard_normal((3, 8)), b1=np.ones(8),
            w2=rng.standard_normal((8, 8)), b2=np.zeros(8), w3=rng.standard_normal(8), b3=np.array(0.2),
            log_armature=np.array(-6.0), armature_slope=rng.standard_normal(3), taps=(0, 2), period=0.002,
            error_scale=0.1, velocity_scale=2.0, torque_scale=0.3, torque_limit=3.0, has_armature=True,
        )  # fmt: skip
    else:
        model = replace(grey_box(encoder_zero=-0.02), copula=Copula(np.eye(3), np.tile(SCORES[:, None], 3)))
    mean, log_var = rng.standard_normal((5, 3)), rng.uniform(-4, 0, (5, 3))
    return MotorPrior(model, mean, log_var, "rollout", "pupper_v2", "m", {"seed": 3}, {"final_loss": 0.5})


@pytest.fixture
def saved(prior: MotorPrior, tmp_path: Path) -> Path:
    path = tmp_path / "prior.safetensors"
    prior.save(path)
    return path


@pytest.fixture
def gain_scaled(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    """A prior of motors with logged gains."""
    box, mean = replace(grey_box(), gain_unit="N·m/rad"), np.random.default_rng(1).standard_normal((3, 3))
    gains = np.array([[20.0, 20.0, 40.0], [1.0, 1.5, 2.0]])
    return MotorPrior(box, mean, mean, "rollout", "go2", "m", {}, {}, ("hip", "thigh", "calf"), gains)


def test_a_prior_keeps_joint_names_and_logged_gains(gain_scaled: MotorPrior, tmp_path: Path):
    gain_scaled.save(tmp_path / "p.safetensors")
    prior = MotorPrior.load(tmp_path / "p.safetensors")
    assert prior.joint_names == gain_scaled.joint_names and prior.model.gain_unit == "N·m/rad"
    np.testing.assert_array_equal(prior.gains, gain_scaled.gains)
    for motors, gains in (
        (prior.training_motors(np.array([2])), [[40.0], [2.0]]),
        (prior.sample(2, 0), [[20.0, 20.0], [1.5, 1.5]]),
        (prior.sample(2, 0, np.ones((2, 2))), np.ones((2, 2))),
    ):
        assert isinstance(motors, GreyBoxActuator)
        np.testing.assert_array_equal(motors.gains, gains)
    np.testing.assert_array_equal(prior.expected(("calf", "tail")), [gain_scaled.mean[2], np.zeros(3)])


def rewrite(path: Path, tensors: dict, header: dict, without: tuple[str, ...] = ()) -> None:
    """Change some tensors and header keys of a file, and drop others."""
    old_tensors, old_header = read_tensors(path)
    both = (old_tensors | tensors, old_header | header)
    write_tensors(path, *({key: value for key, value in one.items() if key not in without} for one in both))


def test_what_is_saved_is_loaded(prior: MotorPrior, saved: Path):
    loaded = MotorPrior.load(saved)
    assert type(loaded.model) is type(prior.model)
    jax.tree.map(np.testing.assert_array_equal, asdict(loaded.model), asdict(prior.model))
    for name in ("mean", "log_var"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(prior, name))
    texts = ("preset", "robot", "motor", "provenance", "metrics")
    assert [getattr(loaded, name) for name in texts] == [getattr(prior, name) for name in texts]


@pytest.mark.parametrize("prior", ["grey box"], indirect=True)
@pytest.mark.parametrize(
    ("tensors", "header", "without"),
    [
        ({}, {}, ("motor_center",)),
        ({"motor_curve": np.zeros(3)}, {}, ()),
        ({}, {"motor_terms": ["heat"]}, ()),
        ({"motor_slope": np.zeros((14, 3))}, {}, ()),
        ({"motor_center": np.full(14, np.nan)}, {}, ()),
        ({}, {"network": {"taps": [0, 2]}}, ()),
        ({}, {"schema_version": 1}, ()),
    ],
)
def test_a_file_that_is_no_prior_is_rejected_by_name(
    saved: Path, tensors: dict, header: dict, without: tuple[str, ...]
):
    rewrite(saved, tensors, header, without)
    with pytest.raises(ArtifactError, match=saved.name):
        MotorPrior.load(saved)
