"""Outlier tests ignore constants in which a prior's motors do not differ. Residuals here are linear in the latents."""

from typing import Any

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.evaluation.outliers import Outliers, outliers
from motorprior.identification.latents import latent_fit
from motorprior.identification.latents.standardise import standardised
from motorprior.identification.search import Search

TRAINED = 12
NEW = 6
SIZE = len(PARAMETERS)
NOTHING: Any = None


class LinearProblem:
    """Motors whose residuals are linear in their latents, ``truth`` (NEW, SIZE); see `search.Problem`."""

    count = NEW
    weight = 2.0
    observations = 20

    def __init__(self, box: GreyBox, truth: np.ndarray):
        rng = np.random.default_rng(7)
        self.box = box
        self.truth = truth
        self.slopes = rng.standard_normal((SIZE, 16 * self.observations))
        self.noise = 0.1 * rng.standard_normal((NEW, 16 * self.observations))

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        return (self.box.decoder_latents(x) - self.truth[problems]) @ self.slopes + self.noise[
            problems
        ]


def found_outliers(monkeypatch: pytest.MonkeyPatch, fixed: int, shift: float = 0.0) -> Outliers:
    """Test of new motors; ``shift`` is added to the viscous_damping of one."""
    rng = np.random.default_rng(1)
    mean = 0.3 * rng.standard_normal((TRAINED, SIZE))
    truth = 0.3 * rng.standard_normal((NEW, SIZE))
    mean[:, :fixed] = truth[:, :fixed] = 0.0
    truth[2, PARAMETERS.index("viscous_damping")] += shift
    box, z, classes = standardised(GreyBox(np.zeros(SIZE), np.eye(SIZE), 0.002), mean)
    monkeypatch.setattr(
        latent_fit, "latent_search", lambda box, *_: Search(LinearProblem(box, truth))
    )
    found = latent_fit.fit_posterior(box, NOTHING, NOTHING, 0.05).mean
    found[:, :fixed] = 0.05  # 5e-8 of the logarithm of a constant
    prior = MotorPrior(box, z, 0.0 * z, "rollout", "", "", {}, given_classes=classes)
    return outliers(prior, found, NOTHING, NOTHING, 0.05, ("",) * NEW)


def test_a_fixed_constant_is_never_reported(monkeypatch: pytest.MonkeyPatch):
    for shift in (0.0, 3.0):
        found = found_outliers(monkeypatch, fixed=2, shift=shift)
        assert not {"kp", "kd_over_kp"} & set(found.latent)
    assert (
        found.latent[2] == "viscous_damping"
        and found.p_value[2] < 1e-4
        and found.deviation[2] > 5.0
    )
    assert 2.5 < found.distance[2] < 4.0
    assert np.all(np.delete(found.p_value, 2) > 0.01)
