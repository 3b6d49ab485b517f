"""A prior's file is what was saved, and a loader refuses what it does not understand."""

from collections.abc import Callable
from dataclasses import asdict, replace
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
from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError
from motorprior.robots.pupper_v2.robot import PUPPER_V2


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
    assert prior.joint_names == gain_scaled.joint_names and prior.model.gain_unit == "N·m/rad"
    np.testing.assert_array_equal(prior.gains, gain_scaled.gains)
    for motors, gains in (
        (prior.training_motors(np.array([2])), [[40.0], [2.0]]),
        (prior.sample(2, 0), [[20.0, 20.0], [1.5, 1.5]]),
        (prior.sample(2, 0, np.ones((2, 2))), np.ones((2, 2))),
    ):
        assert isinstance(motors, GreyBoxActuator)
        np.testing.assert_array_equal(motors.gains, gains)
    log: Any = SimpleNamespace(joint_names=("calf", "tail"), given_classes=())
    found = prior.predicted(log)
    np.testing.assert_array_equal(found.mean, [gain_scaled.mean[2], np.zeros(3)])
    assert np.all(found.std[0] < 0.5) and np.all(found.std[1] == 1.0)


@pytest.fixture
def classed(gain_scaled: MotorPrior) -> MotorPrior:
    """A prior with three classes of one motor each."""
    means = np.array([[-5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [5.0, 0.0, 5.0]])
    classes = ClassLatents(
        ("hip", "thigh", "calf"), ("hip", "thigh", "calf"), means, np.full(3, 4.0)
    )
    return replace(gain_scaled, given_classes=classes, misfit=np.array([0.5, 1.0, 2.0]))


def test_a_joint_gets_a_motor_of_its_class(classed: MotorPrior, tmp_path: Path):
    classed.save(tmp_path / "p.safetensors")
    prior = MotorPrior.load(tmp_path / "p.safetensors")
    joints = tuple(
        replace(joint, name=f"{side}_{kind}", kp=float(row), kd=1.0)
        for side in ("FL", "FR")
        for row, (kind, joint) in enumerate(
            zip(("calf", "hip", "thigh"), PUPPER_V2.joints, strict=False), 1
        )
    )
    robot = replace(PUPPER_V2, joints=joints, given_classes=())
    assert robot.joint_classes == ("calf", "hip", "thigh") * 2
    motors = prior.sample(robot, 0)
    assert isinstance(motors, GreyBoxActuator)
    away = motors.z - prior.classes.mean[[2, 0, 1] * 2]
    assert np.abs(away).max() < 4.0
    np.testing.assert_array_equal(motors.gains, [[1.0, 2.0, 3.0] * 2, np.ones(6)])
    np.testing.assert_array_equal(
        prior.sample(robot, 0, spread=0.0).z, prior.classes.mean[[2, 0, 1] * 2]
    )
    # other words in the robot's file for joints that were recorded
    recorded = tuple(
        replace(joint, name=name)
        for joint, name in zip(joints, ("calf", "hip", "thigh"), strict=False)
    )
    robot = replace(PUPPER_V2, joints=recorded, given_classes=("knee", "abad", "upper"))
    np.testing.assert_array_equal(
        prior.sample(robot, 0, spread=0.0).z, prior.classes.mean[[2, 0, 1]]
    )
    unseen = prior.sample(("tail",) * 500, 0)
    assert unseen.z.std() > 3.5 and np.abs(unseen.z.mean()) < 0.4
    one = prior.sample(("calf",), 0)
    assert isinstance(one, GreyBoxActuator)
    np.testing.assert_array_equal(one.gains, [[40.0], [2.0]])


def test_joints_are_expected_by_name_and_class(classed: MotorPrior):
    log: Any = SimpleNamespace(joint_names=("calf", "other calf"), given_classes=("calf", "calf"))
    found = classed.predicted(log)
    np.testing.assert_array_equal(found.mean, [classed.mean[2], classed.classes.mean[2]])
    np.testing.assert_array_equal(found.std, np.ones((2, 3)))
    np.testing.assert_array_equal(found.misfit, [2.0, 2.0])
    assert classed.joint_classes(("RL_calf_joint", "FL_hip", "tail")) == ("calf", "hip", "")


def test_intervals_hold_the_constants_and_narrow_with_the_log(gain_scaled: MotorPrior):
    sure, unsure = (
        replace(gain_scaled, log_var=np.full((3, 3), value)).intervals() for value in (-8.0, -2.0)
    )
    assert isinstance(gain_scaled.model, GreyBox)
    for name, value in named_constants(
        gain_scaled.model, gain_scaled.mean, gain_scaled.gains
    ).items():
        low, high = sure[name]
        assert np.all(low <= value * (1 + 1e-9) + 1e-12) and np.all(
            high >= value * (1 - 1e-9) - 1e-12
        )
    assert np.all(np.ptp(sure["kp"], axis=0) < 0.2 * np.ptp(unsure["kp"], axis=0))


def rewrite(path: Path, tensors: dict, header: dict, without: tuple[str, ...] = ()) -> None:
    """Change some tensors and header keys of a file, and drop others."""
    old_tensors, old_header = read_tensors(path)
    both = (old_tensors | tensors, old_header | header)
    write_tensors(
        path, *({key: value for key, value in one.items() if key not in without} for one in both)
    )


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
        ({}, {"metrics": {"final_los": 0.5}}, ()),
        ({}, {"metrics": {"residual_percentiles": [[0.1]]}}, ()),
        ({}, {"metrics": {"losses": {"mean": 0.5}}}, ()),
    ],
)
def test_a_file_that_is_no_prior_is_rejected_by_name(
    saved: Path, tensors: dict, header: dict, without: tuple[str, ...]
):
    rewrite(saved, tensors, header, without)
    with pytest.raises(ArtifactError, match=saved.name):
        MotorPrior.load(saved)
