"""A joint that did not move keeps its prior; bands are as wide as the misfit of the log, and of later rows."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.joint_classes import JointClasses
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification import adapt
from motorprior.identification.evaluation.reference import LEVELS, SPEEDS, residual_scale
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.logs.operations import moved

METRICS = {f"residual_p{level:02d}_{speed}": 1e-3 * (level - 50) / 45 for level in LEVELS for speed in SPEEDS}


def test_a_joint_that_is_not_moved_keeps_its_prior(grey_box, monkeypatch: pytest.MonkeyPatch):
    time = np.arange(1000)[:, None]
    target = np.hstack([0.3 * np.sin(0.01 * time), 0.0 * time, 0.0 * time])
    pos = target + np.hstack([0.0 * time, 0.004 * np.sin(0.01 * time), 0.2 * np.sin(0.01 * time)])
    log: Any = SimpleNamespace(
        joint_names=("FL_calf", "FR_calf", "RL_calf"),
        stated_classes=("calf",) * 3,
        joint_pos=pos,
        position_target=target,
    )
    np.testing.assert_array_equal(moved(log), [True, False, True])  # sways with the others; is moved by hand
    classes = JointClasses(("hip", "calf"), ("hip", "calf"), np.array([[-1.0] * 3, [1.0] * 3]), np.full(3, 2.0))
    prior = MotorPrior(
        grey_box(), np.zeros((2, 3)), np.zeros((2, 3)), "rollout", "r", "m", {}, METRICS, stated_classes=classes,
        misfit=np.array([1.0, 0.5]),
    )  # fmt: skip
    found = Posterior(np.full((3, 3), 9.0), np.tile(0.01 * np.eye(3), (3, 1, 1)), np.ones(3), 10)
    recipe: Any = SimpleNamespace(nominal_conditions={})
    monkeypatch.setattr(adapt, "_prepared", lambda *_: (recipe, None, 1.0, ""))
    monkeypatch.setattr(adapt, "recipe_of", lambda _: recipe)
    monkeypatch.setattr(adapt, "fit_posterior", lambda *_, **__: found)
    monkeypatch.setattr(adapt, "replay_errors", lambda *_: (np.full((50, 3), 2e-3), np.zeros((50, 3))))
    posterior = adapt.adapt_to(prior, log)
    np.testing.assert_array_equal(posterior.mean[:, 0], [9.0, 1.0, 9.0])
    np.testing.assert_allclose(np.diagonal(posterior.covariance, axis1=1, axis2=2)[:, 0], [0.01, 1.0, 0.01])
    np.testing.assert_allclose(posterior.misfit, [2.0, 0.5, 2.0])


def test_misfit_is_the_width_of_a_motors_residuals_over_the_fleets():
    rng = np.random.default_rng(0)
    errors = rng.uniform(-1e-3, 1e-3, (20_000, 3)) * np.array([1.0, 3.0, 0.5])
    np.testing.assert_allclose(residual_scale(METRICS, errors, np.zeros_like(errors)), [0.9, 2.7, 0.45], rtol=0.03)
