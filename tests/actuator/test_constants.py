"""Tables of constants of priors, posteriors and fleets: units, ranges, identifiability."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import motorprior as mp
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
    assert prior.constants()["coulomb"].identifiable is False
    assert prior.constants()["armature"].identifiable is None


def test_gains_have_the_unit_that_the_log_states(prior: MotorPrior):
    firmware = replace(
        prior, model=replace(prior.model, gain_unit="firmware"), gains=np.ones((2, 2))
    )
    row = firmware.constants()["kp_per_logged"]

    assert row.unit.startswith("N·m/rad per unit")
    assert row.identifiable

    physical = replace(
        prior, model=replace(prior.model, gain_unit="N·m/rad"), gains=np.full((2, 2), 3.0)
    )

    assert physical.constants()["kp"].median == pytest.approx(3.0 * prior.constants()["kp"].median)


def test_a_repr_is_short_and_a_str_has_the_table(prior: MotorPrior):
    posterior = MotorPosterior(prior, np.zeros((1, 3)), np.eye(3)[None], ("pan",), 8.0, (0.4,))

    for described in (prior, posterior, load_fleet("pupper_v2")):
        assert len(repr(described).splitlines()) <= 10
        assert len(repr(described)) < 1500
        assert "backlash" in str(described)
        assert "N·m/rad" in str(described)

    assert "pan" in str(posterior)
    assert "mrad" in repr(prior)
    assert "pendulum" in repr(prior)


def test_a_plot_of_a_prior_shows_its_responses(prior: MotorPrior):
    (axes,) = mp.plot_steps(prior).axes
    assert max(np.max(line.get_ydata()) for line in axes.lines) > 0.2


def test_a_prior_of_a_bench_fits_a_robot_only_after_for_robot(prior: MotorPrior):
    with pytest.raises(ConfigError) as refusal:
        prior.require("quad", 0.002)
    assert "pendulum" in str(refusal.value)

    for_quad = prior.for_robot("quad")
    for_quad.require("quad", 0.002)

    assert (for_quad.robot, for_quad.joint_names) == ("quad", ())

    replace(prior, robot="").require("quad", 0.002)
