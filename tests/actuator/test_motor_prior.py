"""A loaded prior equals the saved one; a malformed file is rejected; joints get their motors."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from networks import network

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.constants import named_constants
from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.estimates import Estimates
from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Joint


@pytest.fixture(params=["grey box", "network"])
def prior(request: pytest.FixtureRequest, grey_box: Callable[..., GreyBox]) -> MotorPrior:
    rng = np.random.default_rng(0)
    if request.param == "network":
        model = network(taps=(0, 2))
    else:
        model = replace(
            grey_box(encoder_zero=-0.02), copula=Copula(np.eye(3), np.tile(SCORES[:, None], 3))
        )

    mean = rng.standard_normal((5, 3))
    log_var = rng.uniform(-4, 0, (5, 3))

    return MotorPrior(
        model, mean, log_var, "rollout", "pupper_v2", "m", {"seed": 3}, FitMetrics(final_loss=0.5)
    )


@pytest.fixture
def saved(prior: MotorPrior, tmp_path: Path) -> Path:
    path = tmp_path / "prior.safetensors"
    prior.save(path)
    return path


@pytest.fixture
def gain_scaled(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    """A prior of motors with logged gains."""
    box = replace(grey_box(), gain_unit="N·m/rad")
    mean = np.random.default_rng(1).standard_normal((3, 3))
    gains = np.array([[20.0, 20.0, 40.0], [1.0, 1.5, 2.0]])
    return MotorPrior(
        box, mean, mean, "rollout", "go2", "m", {}, FitMetrics(), ("hip", "thigh", "calf"), gains
    )


def test_a_prior_keeps_joint_names_and_logged_gains(gain_scaled: MotorPrior, tmp_path: Path):
    gain_scaled.save(tmp_path / "p.safetensors")
    prior = MotorPrior.load(tmp_path / "p.safetensors")

    assert prior.joint_names == gain_scaled.joint_names
    assert prior.model.gain_unit == "N·m/rad"
    np.testing.assert_array_equal(prior.gains, gain_scaled.gains)


def test_motors_get_logged_gains_of_their_own_or_of_the_median(gain_scaled: MotorPrior):
    prior = gain_scaled

    for motors, gains in (
        (prior.training_motors(np.array([2])), [[40.0], [2.0]]),
        (prior.sample(2, 0), [[20.0, 20.0], [1.5, 1.5]]),
        (prior.sample(2, 0, np.ones((2, 2))), np.ones((2, 2))),
    ):
        assert isinstance(motors, GreyBoxActuator)
        np.testing.assert_array_equal(motors.gains, gains)


def test_only_a_recorded_joint_is_predicted_by_its_posterior(gain_scaled: MotorPrior):
    log: Any = SimpleNamespace(joint_names=("calf", "tail"), given_classes=())

    predicted = gain_scaled.predicted(log)

    np.testing.assert_array_equal(predicted.mean, [gain_scaled.mean[2], np.zeros(3)])
    assert np.all(predicted.std[0] < 0.5)
    assert np.all(predicted.std[1] == 1.0)


@pytest.fixture
def classed(gain_scaled: MotorPrior) -> MotorPrior:
    """A prior with three classes of one motor each."""
    means = np.array([[-5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [5.0, 0.0, 5.0]])
    names = ("hip", "thigh", "calf")
    classes = ClassLatents(names, names, means, np.full(3, 4.0))
    return replace(gain_scaled, given_classes=classes, misfit=np.array([0.5, 1.0, 2.0]))


CLASS_ROWS = [2, 0, 1]
"""Rows of calf, hip and thigh in the prior's classes."""


@pytest.fixture
def reloaded(classed: MotorPrior, tmp_path: Path) -> MotorPrior:
    """The prior with three classes, after saving and loading."""
    classed.save(tmp_path / "p.safetensors")
    return MotorPrior.load(tmp_path / "p.safetensors")


def joints_named(names: Sequence[str]) -> list[Joint]:
    """Joints with these names; kp is 1, 2 and 3 N·m/rad in turn, kd 1 N·m·s/rad."""
    pattern = PUPPER_V2.joints[:3]
    return [
        replace(pattern[index % 3], name=name, kp=float(index % 3 + 1), kd=1.0)
        for index, name in enumerate(names)
    ]


def test_a_joint_gets_a_motor_of_its_class(reloaded: MotorPrior):
    names = ("FL_calf", "FL_hip", "FL_thigh", "FR_calf", "FR_hip", "FR_thigh")
    robot = replace(PUPPER_V2, joints=tuple(joints_named(names)), given_classes=())
    assert robot.joint_classes == ("calf", "hip", "thigh") * 2

    motors = reloaded.sample(robot, 0)
    central = reloaded.sample(robot, 0, spread=0.0)

    class_means = reloaded.classes.mean[CLASS_ROWS * 2]
    assert isinstance(motors, GreyBoxActuator)
    assert np.abs(motors.z - class_means).max() < 4.0
    np.testing.assert_array_equal(motors.gains, [[1.0, 2.0, 3.0] * 2, np.ones(6)])
    np.testing.assert_array_equal(central.z, class_means)


def test_a_recorded_joint_gets_its_motor_whatever_the_robot_calls_its_class(reloaded: MotorPrior):
    joints = tuple(joints_named(("calf", "hip", "thigh")))
    robot = replace(PUPPER_V2, joints=joints, given_classes=("knee", "abad", "upper"))

    central = reloaded.sample(robot, 0, spread=0.0)

    np.testing.assert_array_equal(central.z, reloaded.classes.mean[CLASS_ROWS])


def test_a_joint_of_an_unknown_class_gets_any_motor(reloaded: MotorPrior):
    joints = tuple(joints_named(tuple(f"tail{index}" for index in range(500))))
    motors = reloaded.sample(replace(PUPPER_V2, joints=joints, given_classes=("tail",) * 500), 0)

    # the means of the classes are up to 10 apart
    assert motors.z.std() > 3.5
    assert np.abs(motors.z.mean()) < 0.4


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("calff", "calf"), ("FL_thig_joint", "thigh"), ("tail", "hip, thigh, calf")],
)
def test_an_unknown_name_is_an_error_with_the_nearest_names(
    reloaded: MotorPrior, name: str, nearest: str
):
    uses = (partial(reloaded.constants, name), partial(reloaded.sample, (name,), 0))
    for use in uses:
        with pytest.raises(ConfigError, match=f"'{name}'") as error:
            use()
        assert nearest in (error.value.remedy or "")


def test_a_prior_of_one_class_has_it_for_any_joint_but_no_constants_of_another(
    gain_scaled: MotorPrior,
):
    assert len(gain_scaled.sample(("wrist", "elbow"), 0).z) == 2
    with pytest.raises(ConfigError, match="'wrist'"):
        gain_scaled.constants("wrist")


def test_a_number_of_motors_of_a_prior_with_classes_is_an_error(reloaded: MotorPrior):
    assert len(reloaded.sample(3, 0).z) == 3  # one per training motor
    with pytest.raises(ConfigError, match="12 motors") as error:
        reloaded.sample(12, 0)
    assert "('hip',) * 12" in (error.value.remedy or "")


def test_a_joint_without_gains_gets_the_logged_gains_of_its_class(reloaded: MotorPrior):
    motors = reloaded.sample(("calf",), 0)

    assert isinstance(motors, GreyBoxActuator)
    np.testing.assert_array_equal(motors.gains, [[40.0], [2.0]])


def test_joints_are_predicted_by_name_and_class(classed: MotorPrior):
    log: Any = SimpleNamespace(joint_names=("calf", "other calf"), given_classes=("calf", "calf"))
    predicted = classed.predicted(log)

    np.testing.assert_array_equal(predicted.mean, [classed.mean[2], classed.classes.mean[2]])
    np.testing.assert_array_equal(predicted.std, np.ones((2, 3)))
    np.testing.assert_array_equal(predicted.misfit, [2.0, 2.0])
    assert classed.joint_classes(("RL_calf_joint", "FL_hip", "tail")) == ("calf", "hip", "")


def with_estimates(prior: MotorPrior, std: float) -> MotorPrior:
    """The prior with this standard deviation of the logarithms of all constants."""
    size = len(PARAMETERS)
    covariance = np.tile(std**2 * np.eye(size), (len(prior.mean), 1, 1))
    return replace(prior, estimates=Estimates(covariance, np.zeros((len(prior.mean), size))))


def test_intervals_contain_the_constants_and_narrow_with_the_estimates(gain_scaled: MotorPrior):
    narrow = with_estimates(gain_scaled, 0.01).intervals()
    wide = with_estimates(gain_scaled, 0.2).intervals()

    assert isinstance(gain_scaled.model, GreyBox)
    constants = named_constants(gain_scaled.model, gain_scaled.mean, gain_scaled.gains)
    for name, value in constants.items():
        low, high = narrow[name]
        assert np.all(low <= value * (1 + 1e-9) + 1e-12)
        assert np.all(high >= value * (1 - 1e-9) - 1e-12)

    assert np.all(np.ptp(narrow["kp"], axis=0) < 0.2 * np.ptp(wide["kp"], axis=0))


def rewrite(path: Path, tensors: dict, header: dict, without: tuple[str, ...] = ()) -> None:
    """Change some tensors and header keys of a file, and drop others."""
    old_tensors, old_header = read_tensors(path)
    new_tensors = old_tensors | tensors
    new_header = old_header | header
    for key in without:
        new_tensors.pop(key, None)
        new_header.pop(key, None)

    write_tensors(path, new_tensors, new_header)


def test_a_loaded_prior_equals_the_saved_one(prior: MotorPrior, saved: Path):
    loaded = MotorPrior.load(saved)

    assert type(loaded.model) is type(prior.model)
    jax.tree.map(np.testing.assert_array_equal, asdict(loaded.model), asdict(prior.model))
    for name in ("mean", "log_var"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(prior, name))

    for name in ("preset", "robot", "motor", "provenance", "metrics"):
        assert getattr(loaded, name) == getattr(prior, name)


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
        ({}, {"metrics": {"final_los": 0.5}}, ()),
        ({}, {"metrics": {"residual_percentiles": [[0.1]]}}, ()),
        ({}, {"metrics": {"losses": {"mean": 0.5}}}, ()),
    ],
)
def test_a_malformed_file_is_rejected(
    saved: Path, tensors: dict, header: dict, without: tuple[str, ...]
):
    rewrite(saved, tensors, header, without)
    with pytest.raises(ArtifactError) as refusal:
        MotorPrior.load(saved)

    assert saved.name in str(refusal.value)
