"""Outlier tests ignore constants in which a prior's motors do not differ.

Residuals here are linear in the latents.
"""

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
    """Problem of motors with residuals that are linear in their latents, ``truth`` (NEW, SIZE)."""

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
        error = self.box.decoder_latents(x) - self.truth[problems]
        return error @ self.slopes + self.noise[problems]


def outliers_among(monkeypatch: pytest.MonkeyPatch, fixed: int, shift: float = 0.0) -> Outliers:
    """Outliers among new motors of a prior.

    Args:
        monkeypatch: replaces the search over a log by a linear problem.
        fixed: number of constants in which the prior's motors do not differ.
        shift: added to the logarithm of the viscous_damping of one new motor.
    """
    rng = np.random.default_rng(1)
    mean = 0.3 * rng.standard_normal((TRAINED, SIZE))
    truth = 0.3 * rng.standard_normal((NEW, SIZE))
    mean[:, :fixed] = 0.0
    truth[:, :fixed] = 0.0
    truth[2, PARAMETERS.index("viscous_damping")] += shift
    box, z, classes = standardised(GreyBox(np.zeros(SIZE), np.eye(SIZE), 0.002), mean)

    def linear_search(box: GreyBox, *_: Any) -> Search:
        return Search(LinearProblem(box, truth))

    monkeypatch.setattr(latent_fit, "latent_search", linear_search)
    latents = latent_fit.fit_posterior(box, NOTHING, NOTHING, 0.05).mean
    latents[:, :fixed] = 0.05  # 5e-8 of the logarithm of a constant
    prior = MotorPrior(box, z, 0.0 * z, "rollout", "", "", {}, given_classes=classes)

    return outliers(prior, latents, NOTHING, NOTHING, 0.05, ("",) * NEW)


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_a_fixed_constant_is_never_reported(monkeypatch: pytest.MonkeyPatch, shift: float):
    result = outliers_among(monkeypatch, fixed=2, shift=shift)

    assert not {"kp", "kd_over_kp"} & set(result.latent)


def test_a_shifted_constant_of_one_motor_is_an_outlier(monkeypatch: pytest.MonkeyPatch):
    result = outliers_among(monkeypatch, fixed=2, shift=3.0)

    assert result.latent[2] == "viscous_damping"
    assert result.p_value[2] < 1e-4
    assert result.deviation[2] > 5.0
    assert 2.5 < result.distance[2] < 4.0
    assert np.all(np.delete(result.p_value, 2) > 0.01)
