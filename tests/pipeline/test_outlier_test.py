"""What a table says of a motor: why it is unlike the fleet, and nothing of a sound one."""

from typing import Any

import numpy as np
import pytest

from motorprior.identification.judging import reference
from motorprior.identification.latents import outliers
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.identification.latents.outliers import Outliers
from motorprior.pipeline import adapt

BADLY = np.array([0.8, 1e-6, 0.8, 0.004])
FAR = Outliers(np.array([0.3, 0.5, 1e-5, 0.9]), ("kp", "kp", "delay", "kp"), np.array([1.0, 0.2, -9.04, 0.1]))


@pytest.mark.parametrize("motors", [5, 1])
def test_only_motors_that_are_called_odd_are_said_to_deviate(
    monkeypatch: pytest.MonkeyPatch, grey_network: Any, motors: int
):
    """The bound of four motors is 0.0025: the last motor is below 0.01, and sound."""
    latents, found = np.zeros((motors, 3)), np.zeros((4, 3))
    prior: Any = adapt.MotorPrior(grey_network(), latents, latents, "rollout", "r", "m", {}, {})
    nothing: Any = None
    monkeypatch.setattr(adapt, "_prepared", lambda *_: (None, None, 1.0, ""))
    monkeypatch.setattr(reference, "num_blocks", lambda *_: 1.0)
    monkeypatch.setattr(reference, "loss_p_value", lambda *_: BADLY)
    monkeypatch.setattr(outliers, "outliers", lambda *_: FAR)
    posterior = Posterior(found, np.stack([np.eye(3)] * 4), np.ones(4), 9)
    test = adapt.outlier_test(prior, "prior", nothing, "log", posterior)
    if motors == 1:  # nothing is known of how far motors are apart
        assert test.reason == ("", "it fits its log badly", "", "")
        np.testing.assert_array_equal(test.p_value, BADLY)
    else:
        assert test.reason == ("", "it fits its log badly", "its delay is -9.0 deviations from theirs", "")
        np.testing.assert_allclose(test.p_value, [0.6, 2e-6, 2e-5, 0.008])
