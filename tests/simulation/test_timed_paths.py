"""Medians are of enough rounds, and a path that cannot be timed is missing only where its library is."""

import sys

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.bullet_backend import PybulletBackend
from motorprior.simulation.timed_paths import TimedPath, interpreted_paths, measure


@pytest.mark.parametrize("repeats", [-1, 3, 6])
def test_a_median_is_of_an_odd_number_of_rounds_and_at_least_five(repeats: int):
    with pytest.raises(ConfigError, match=f"{repeats} repeats are even or below 5"):
        measure({"a": TimedPath(10, lambda: 0.1)}, repeats)


def test_pybullet_is_left_out_where_it_is_not_installed(monkeypatch: pytest.MonkeyPatch, grey_network):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    paths = interpreted_paths(PUPPER_V2, LatentActuator(grey_network(), np.zeros((12, 3))))
    assert {"python_numpy"} <= set(paths) <= {"python_numpy", "python_torch"}


def test_what_else_is_wrong_with_pybullet_is_told(monkeypatch: pytest.MonkeyPatch, grey_network):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")

    def broken(*_: object) -> None:
        raise ConfigError("broken")

    monkeypatch.setattr(PybulletBackend, "__init__", broken)
    with pytest.raises(ConfigError, match="broken"):
        interpreted_paths(PUPPER_V2, LatentActuator(grey_network(), np.zeros((12, 3))))
