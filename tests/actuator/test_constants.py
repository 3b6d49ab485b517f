"""Priors, posteriors and fleets state their constants as a table with units, ranges and identifiability."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ConfigError


@pytest.fixture
def prior(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    box = grey_box(spread=0.2)
    z = np.zeros((2, 3))
    metrics = FitMetrics(identified={"kp": True, "coulomb": False}, replay_rmse=0.004)
    return MotorPrior(box, z, z, "rollout", "pendulum", "a servo", {"text": "x" * 20_000}, metrics)


def test_a_prior_has_the_quantiles_of_its_samples(prior: MotorPrior):
    kp = prior.constants()["kp"]
    samples = prior.sample(4000, 1).constants()["kp"]  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(
        [kp.low, kp.median, kp.high], np.quantile(samples, [0.05, 0.5, 0.95]), rtol=0.05
    )
    assert (kp.unit, kp.identifiable) == ("N·m/rad", True)
    assert [prior.constants()[name].identifiable for name in ("coulomb", "armature")] == [
        False,
        None,
    ]


def test_gains_of_a_firmware_have_units_of_their_own(prior: MotorPrior):
    firmware = replace(
        prior, model=replace(prior.model, gain_unit="firmware"), gains=np.ones((2, 2))
    )
    row = firmware.constants()["kp_per_logged"]
    assert row.unit.startswith("N·m/rad per unit") and row.identifiable
    physical = replace(
        prior, model=replace(prior.model, gain_unit="N·m/rad"), gains=np.full((2, 2), 3.0)
    )
    assert physical.constants()["kp"].median == pytest.approx(3.0 * prior.constants()["kp"].median)


def test_what_is_printed_is_short_and_has_the_table(prior: MotorPrior):
    posterior = MotorPosterior(prior, np.zeros((1, 3)), np.eye(3)[None], ("pan",), 8.0, (0.4,))
    for each in (prior, posterior, load_fleet("pupper_v2")):
        assert len(repr(each).splitlines()) <= 10 and len(repr(each)) < 1500
        assert "backlash" in str(each) and "N·m/rad" in str(each)
    assert "pan" in str(posterior) and "mrad" in repr(prior) and "pendulum" in repr(prior)


def test_a_response_is_drawn(prior: MotorPrior):
    (axes,) = prior.plot().axes
    assert max(line.get_ydata().max() for line in axes.lines) > 0.2


def test_motors_of_a_bench_become_those_of_a_robot(prior: MotorPrior):
    with pytest.raises(ConfigError, match="pendulum"):
        prior.require("quad", 0.002)
    other = prior.for_robot("quad")
    other.require("quad", 0.002)
    assert (other.robot, other.joint_names) == ("quad", ())
    replace(prior, robot="").require("quad", 0.002)
