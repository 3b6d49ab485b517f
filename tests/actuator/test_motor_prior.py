"""A prior's file is what was saved, and a loader refuses what it does not understand."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import SCHEMA_VERSION, MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.dynamometer import Trial, run
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
def told(grey_network: Callable[..., LatentNetwork]) -> MotorPrior:
    """Of motors that were told gains."""
    network, mean = replace(grey_network(), gain_unit="N·m/rad"), np.random.default_rng(1).standard_normal((3, 3))
    gains = np.array([[20.0, 20.0, 40.0], [1.0, 1.5, 2.0]])
    return MotorPrior(network, mean, mean, "rollout", "go2", "m", {}, {}, ("hip", "thigh", "calf"), gains)


def test_a_prior_knows_whose_motors_it_saw_and_what_gains_they_were_told(told: MotorPrior, tmp_path: Path):
    told.save(tmp_path / "p.safetensors")
    prior = MotorPrior.load(tmp_path / "p.safetensors")
    assert prior.joint_names == told.joint_names and prior.network.gain_unit == "N·m/rad"
    np.testing.assert_array_equal(prior.gains, told.gains)
    np.testing.assert_array_equal(prior.training_motors(np.array([2])).gains, [[40.0], [2.0]])
    np.testing.assert_array_equal(prior.sample(2, 0).gains, [[20.0, 20.0], [1.5, 1.5]])
    np.testing.assert_array_equal(prior.sample(2, 0, np.ones((2, 2))).gains, np.ones((2, 2)))
    np.testing.assert_array_equal(prior.expected(("calf", "tail")), [told.mean[2], np.zeros(3)])


def test_a_spread_is_that_of_z(prior: MotorPrior):
    usual, wide, mean = (prior.sample(7, 3, spread=spread).z for spread in (1.0, 1.5, 0.0))
    np.testing.assert_allclose(wide, 1.5 * usual)
    np.testing.assert_array_equal(usual, prior.sample(7, 3).z)
    assert not mean.any() and usual.std() > 0.5


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
    ("tensors", "header", "without", "words"),
    [
        ({}, {}, ("motor_center",), "missing keys .'motor_center'"),
        ({}, {}, ("motor_slope",), "missing keys .'motor_slope'"),
        ({"motor_curve": np.zeros(3)}, {}, (), "unknown keys .'motor_curve'"),
        ({}, {"grey_box": False}, (), "unknown keys .'motor_center', 'motor_slope'"),
        ({}, {"grey_box": 1}, (), "grey_box = 1 is not true or false"),
        ({}, {}, ("grey_box",), "missing keys .'grey_box'"),
        ({}, {"motor_parameters": ["kp", "kd"]}, (), "motor_parameters are not theirs"),
        ({}, {"motor_parameters": ["kp", 2]}, (), "motor_parameters = .'kp', 2. is not "),
        ({}, {"motor_terms": ["warmth"]}, (), "motor_terms = .'warmth'. is not a list of .* profile"),
        ({}, {"motor_terms": "heat"}, (), "motor_terms = 'heat' is not a list"),
        ({}, {"motor_terms": ["heat"]}, (), r"motor_center is float64\(14,\), wanted float64\(16,\)"),
        ({}, {"motor_terms": ["output_encoder"] * 2}, (), "motor_terms are not in their order"),
        ({}, {}, ("motor_terms",), "missing keys .'motor_terms'"),
        ({}, {}, ("motor_parameters",), "missing keys .'motor_parameters'"),
        ({"motor_center": np.zeros(13)}, {}, (), r"motor_center is float64\(13,\), wanted float64\(14,\)"),
        ({"motor_slope": np.zeros((14, 3))}, {}, (), r"motor_slope is float64\(14, 3\), wanted float64\(3, 14\)"),
        ({"motor_center": np.zeros(14, np.float32)}, {}, (), "motor_center is float32"),
        ({"motor_center": np.full(14, np.nan)}, {}, (), r"motor_center\[0\] is not finite"),
        ({"motor_slope": np.full((3, 14), 2e4)}, {}, (), "motor_slope holds 2e.04, beyond 10"),
        ({"motor_slope": np.full((3, 14), -10.1)}, {}, (), "motor_slope holds 10.1, beyond 10"),
        ({"armature_slope": np.full(3, 10.1)}, {}, (), "armature_slope holds 10.1, beyond 10"),
        (
            {"motor_center": np.full(14, -30.0)},
            {},
            (),
            "motor_center: kp = 9.35762e-14 is not a finite number from 0.001 to 1e.03",
        ),
        (
            {},
            {"metrics": {"final_loss": 10**400}},
            (),
            "metrics: final_loss = 1000.* is not a finite number from -1e.12 to 1e.12",
        ),
        ({}, {"metrics": {"loss": 0.5}}, (), "metrics: 'loss' is no figure of an identification"),
        ({}, {"metrics": {"saved_warmth": 0.5}}, (), "metrics: 'saved_warmth' is no figure of an identification"),
        ({}, {"metrics": {"final_loss": True}}, (), "metrics: final_loss = True is not a finite number"),
        ({}, {"metrics": {"final_loss": "0.5"}}, (), "metrics: final_loss = '0.5' is not a finite number"),
        (
            {},
            {"metrics": {"final_loss": -1.1e12}},
            (),
            "metrics: final_loss = -1.1e.12 is not a finite number from -1e.12 to 1e.12",
        ),
        (
            {},
            {"metrics": {"final_loss": 10**100}},
            (),
            "metrics: final_loss = 1000.* is not a finite number from -1e.12 to 1e.12",
        ),
        (
            {},
            {"metrics": {"loss_log_std": 1e200}},
            (),
            "metrics: loss_log_std = 1e.200 is not a finite number from -1e.06 to 1e.06",
        ),
        ({}, {"has_armature": True}, (), "grey_box and has_armature are both true"),
        ({}, {"schema_version": 1}, (), f"schema_version = 1 is not {SCHEMA_VERSION}"),
    ],
)
def test_a_motor_that_does_not_fit_is_refused_by_name(
    saved: Path, tensors: dict, header: dict, without: tuple[str, ...], words: str
):
    rewrite(saved, tensors, header, without)
    with pytest.raises(ArtifactError, match=words) as error:
        MotorPrior.load(saved)
    assert saved.name in str(error.value)


TERMS_OF_ONE = ("profile", "output_encoder", "asymmetry", "heat")


@pytest.fixture
def servo(grey_network: Callable[..., LatentNetwork]) -> MotorPrior:
    """Motors with terms and without a network."""
    network = grey_network(terms=TERMS_OF_ONE, asymmetry=-0.1)
    weights = {"w1": np.zeros((6, 0)), "v1": np.zeros((3, 0)), "w2": np.zeros((0, 0))}
    weights |= {name: np.zeros(0) for name in ("b1", "b2", "w3")}
    z = np.random.default_rng(0).standard_normal((5, 3))
    return MotorPrior(replace(network, **weights), z, 0.0 * z, "rollout", "pupper_v2", "m", {}, {})


def test_motors_with_terms_and_without_a_network_are_loaded_as_they_were(servo: MotorPrior, tmp_path: Path):
    path = tmp_path / "prior.safetensors"
    servo.save(path)
    loaded = MotorPrior.load(path)
    assert loaded.network.motor is not None and loaded.network.motor.terms == TERMS_OF_ONE
    assert loaded.network.num_neurons == 0 and loaded.sha256() == servo.sha256()
    before, after = (one.network.constants(one.mean) for one in (servo, loaded))
    assert before.keys() == after.keys() and np.all(after["profile_speed"] > 0.0)
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values)
    step = np.full((300, 5), 0.3)
    case = Trial(step, 0.0 * step, np.full(5, 0.002), 0.002)
    moved = run(loaded.training_motors(np.arange(5)), case).joint_pos
    np.testing.assert_array_equal(moved, run(servo.training_motors(np.arange(5)), case).joint_pos)
    assert np.all(moved[-1] > 0.15)


def test_draws_are_standard_normal(prior: MotorPrior):
    z = prior.sample(100_000, np.random.default_rng(0)).z
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose(np.cov(z.T), np.eye(z.shape[1]), atol=0.03)
