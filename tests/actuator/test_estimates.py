"""Estimates of constants: intervals from the joint covariance, and what counts as identified."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.constants import Estimate
from motorprior.actuator.estimates import (
    COMBINATIONS,
    MAX_BOUND,
    MAX_RATIO,
    SCORE,
    Estimates,
    coordinate,
    is_identified,
    value_at,
)
from motorprior.actuator.geared_motor_step import MAX_DELAY, PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.robots.pupper_v2.robot import PUPPER_V2

SIZE = len(PARAMETERS)


@pytest.mark.parametrize("name", ["kp", "gear_stiffness", "encoder_zero"])
def test_a_coordinate_returns_the_value(name: str):
    values = np.array([0.02, 3.0])
    scale = np.array([0.0, 0.5])

    np.testing.assert_allclose(value_at(name, coordinate(name, values, scale), scale), values)


def test_an_interval_far_below_the_scale_begins_at_0_and_that_of_a_gear_is_open():
    y = coordinate("coulomb", np.array([1e-4]), np.array([0.01]))
    assert value_at("coulomb", y - 0.1, np.array([0.01]))[0] == 0.0

    y = coordinate("gear_stiffness", np.array([1e5]), np.array([1e-3]))
    assert np.isinf(value_at("gear_stiffness", y - 0.1, np.array([1e-3])))[0]


def alike(value: float) -> dict[str, np.ndarray]:
    """Constants of one motor, all with this value."""
    return {name: np.full(1, value) for name in PARAMETERS}


def estimates(std: float, correlation: float = 0.0) -> Estimates:
    """Estimates of one motor; kp and armature are correlated."""
    matrix = std**2 * np.eye(SIZE)
    kp = PARAMETERS.index("kp")
    armature = PARAMETERS.index("armature")
    matrix[kp, armature] = matrix[armature, kp] = correlation * std**2
    return Estimates(matrix[None], np.zeros((1, SIZE)))


def test_a_constant_is_identified_if_its_interval_is_narrower_than_the_factor():
    values = alike(1.0)
    limit = 0.5 * np.log(MAX_RATIO) / SCORE

    assert estimates(0.99 * limit).identified(values, ())["kp"].all()
    assert not estimates(1.01 * limit).identified(values, ())["kp"].any()


def test_an_interval_of_what_the_log_does_not_say_is_open():
    values = alike(1.0)
    limit = np.log(MAX_BOUND) / SCORE

    low, high = estimates(0.99 * limit).ends(values, ())["kp"]
    np.testing.assert_allclose([low[0], high[0]], [1.0 / MAX_BOUND, MAX_BOUND], rtol=0.05)

    low, high = estimates(1.01 * limit).ends(values, ())["kp"]
    assert (low[0], high[0]) == (0.0, np.inf)
    assert str(Estimate(1.0, low[0], high[0], False)) == "not identified"


def test_a_delay_has_no_bound_beyond_the_delay_line():
    low, high = estimates(0.5).ends(alike(0.9 * MAX_DELAY), ())["delay"]

    assert low[0] > 0.0
    assert np.isinf(high[0])


def test_a_ratio_is_identified_while_its_parts_are_not():
    values = alike(1.0)
    trading = estimates(2.0, correlation=0.999)

    low, high = trading.combination_ends(values, ())["kp_per_armature"]

    assert not trading.identified(values, ())["kp"].any()
    assert not trading.identified(values, ())["armature"].any()
    assert high < MAX_RATIO * low
    # the logarithm of a ratio has the variance of a difference
    std = 2.0 * np.sqrt(2.0 - 2.0 * 0.999)
    np.testing.assert_allclose(np.log(high / low), 2.0 * SCORE * std, rtol=1e-3)


def test_a_limit_that_is_not_identified_is_at_least_what_was_logged():
    values = alike(40.0)
    wide = estimates(3.0)
    scale = wide.scale.copy()
    scale[:, PARAMETERS.index("torque_limit")] = 2.5

    low, high = replace(wide, scale=scale).ends(values, ())["torque_limit"]

    assert low.tolist() == [2.5]
    assert np.isinf(high).all()


def test_a_limit_in_force_is_not_at_least_what_the_unlimited_motor_requested():
    values = alike(3.0)  # the log requested up to 17 N·m
    uncertain = estimates(0.5)
    scale = uncertain.scale.copy()
    scale[:, PARAMETERS.index("torque_limit")] = 17.0

    low, high = replace(uncertain, scale=scale).ends(values, ())["torque_limit"]

    assert not is_identified("torque_limit", np.stack([low, high])).any()
    np.testing.assert_allclose(low, 3.0 * np.exp(-0.5 * SCORE))
    np.testing.assert_allclose(high, 3.0 * np.exp(0.5 * SCORE))


def test_every_combination_names_its_parts():
    constants = {name: np.full(1, 2.0) for name in PARAMETERS}
    for combination in COMBINATIONS:
        value = combination.value(constants)
        for name in PARAMETERS:
            changed = combination.value(constants | {name: np.full(1, 3.0)})
            assert (changed != value).any() == (name in combination.parts)


def test_a_signed_constant_is_identified_within_its_unit():
    assert is_identified("encoder_zero", np.array([[-0.01], [0.01]])).all()
    assert not is_identified("encoder_zero", np.array([[-0.1], [0.1]])).any()


@pytest.fixture
def prior(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    """Twelve motors whose logs reached 1 N·m, and do not identify the torque limit of 40 N·m."""
    box = grey_box(spread=0.1, torque_limit=40.0)
    z = np.zeros((12, 3))
    covariance = np.tile(0.01 * np.eye(SIZE), (12, 1, 1))
    limit = PARAMETERS.index("torque_limit")
    covariance[:, limit, limit] = 25.0
    scale = np.zeros((12, SIZE))
    scale[:, limit] = 1.0
    of_logs = Estimates(covariance, scale)
    return MotorPrior(box, z, z, "rollout", "pupper_v2", "m", {}, estimates=of_logs)


def test_samples_of_a_robot_have_its_torque_limit_where_no_log_reached_one(prior: MotorPrior):
    described = [joint.torque_limit for joint in PUPPER_V2.joints]

    of_robot = prior.sample(PUPPER_V2, 0).constants()["torque_limit"]  # pyright: ignore
    without_robot = prior.sample(12, 0).constants()["torque_limit"]  # pyright: ignore

    np.testing.assert_allclose(of_robot, described)
    assert without_robot.min() > 10.0


def test_samples_have_no_smaller_torque_limit_than_the_logs_reached(prior: MotorPrior):
    assert prior.estimates is not None
    strong = replace(prior, estimates=replace(prior.estimates, scale=5.0 * prior.estimates.scale))

    limits = strong.sample(PUPPER_V2, 0).constants()["torque_limit"]  # pyright: ignore

    np.testing.assert_allclose(limits, 5.0)


def test_estimates_are_saved(prior: MotorPrior, tmp_path):
    prior.save(tmp_path / "prior.safetensors")
    loaded = MotorPrior.load(tmp_path / "prior.safetensors")

    assert loaded.estimates is not None
    for name, ends in prior.intervals().items():
        np.testing.assert_array_equal(loaded.intervals()[name], ends)


def test_tables_separate_the_estimate_from_the_range_between_units(prior: MotorPrior):
    row = prior.constants()["kp"]
    limit = prior.constants()["torque_limit"]

    assert row.estimate is not None
    assert row.identifiable
    np.testing.assert_allclose(np.log(row.estimate.high / row.estimate.low), 0.2 * SCORE, rtol=1e-3)
    assert "≥ 1" in limit.estimate_text
    assert limit.identifiable is False
    for text in ("90 % interval", "range between units", "not identified"):
        assert text in str(prior)
