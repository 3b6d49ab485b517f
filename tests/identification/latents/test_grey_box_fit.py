"""How long the search for new motors goes on. No motor is simulated: residuals are functions of the latents."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents import grey_box_fit
from motorprior.identification.latents.grey_box_fit import adapt

NEW, SIZE = 6, 14
NOTHING: Any = None


class RuggedRuns:
    """In place of `WindowRuns`: residuals grow with the distance from ``truth`` (NEW, SIZE), with ``ripples``.

    Those of the first motor are ``odd``, more than any latents explain.
    """

    windows, channels, num_motors = 20, 2, NEW

    def __init__(self, ripples: float, odd: float = 0.0):
        self.truth, self.ripples = 0.7 * np.random.default_rng(7).standard_normal((NEW, SIZE)), ripples
        self.odd = odd * (np.arange(NEW) == 0)

    def residuals(self, network: object, z: np.ndarray, motor: np.ndarray) -> np.ndarray:
        off = z - self.truth[motor]
        rows = np.concatenate([0.3 * off, self.ripples * np.sin(4.0 * off)], axis=1)
        rows = (rows + self.odd[motor][:, None]).astype(np.float32)
        return np.broadcast_to(rows[:, None, None], (len(z), self.windows, self.channels, rows.shape[1]))


def found(monkeypatch: pytest.MonkeyPatch, ripples: float, odd: float = 0.0) -> np.ndarray:
    """(NEW, SIZE) distance of what is found from the truth."""
    runs = RuggedRuns(ripples, odd)
    monkeypatch.setattr(grey_box_fit, "WindowRuns", lambda *_: runs)
    network = cast(LatentNetwork, SimpleNamespace(num_latents=SIZE))
    return np.abs(adapt(network, NOTHING, NOTHING, 0.01, None).mean - runs.truth)


@pytest.mark.parametrize("odd", [0.0, 1e4])
def test_a_search_goes_on_while_further_beginnings_help(monkeypatch: pytest.MonkeyPatch, odd: float):
    """After five the motors are 0.24 off in the mean; one that nothing fits does not end the search for the others."""
    assert found(monkeypatch, 0.3, odd)[1:].mean() < 0.1
