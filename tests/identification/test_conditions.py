"""Logged voltage and temperature do not change z."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.physics.term_selection import same_conditions
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.training_data.windows import TrainingData

Networks = Callable[..., GreyBox]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60, window=64)
Z = np.array([[0.8, -1.2, 0.4], [-0.5, 0.7, 1.1], [0.1, 0.2, -1.0]])
SETUPS = {"usual": (1.0, 0.0), "weak and hot": (0.7, 40.0)}


@pytest.fixture(scope="module")
def driven_by_voltage(grey_box: Networks) -> GreyBox:
    """Servos that command a duty cycle, with torques that fall by 30 % when they are 50 K warmer."""
    return grey_box(terms=("supply", "temperature"), supply_share=1.0, temperature_loss=0.3)


def under(decoder_data: Data, box: GreyBox, supply: float, temperature_rise: float) -> TrainingData:
    return decoder_data(box, Z, supply=(supply,), temperature_rise=(temperature_rise,))


@pytest.mark.parametrize("setup", SETUPS)
def test_z_does_not_depend_on_the_conditions(decoder_data: Data, driven_by_voltage: GreyBox, setup: str):
    data = under(decoder_data, driven_by_voltage, *SETUPS[setup])
    found = fit_posterior(driven_by_voltage, data, replace(PRESET, num_latents=3), 0.01)
    spread = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.all(np.abs(found.mean - Z) < np.maximum(3.0 * spread, 0.05))


def test_only_conditions_that_differ_between_segments_are_fitted(decoder_data: Data, driven_by_voltage: GreyBox):
    both = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), temperature_rise=(0.0, 30.0))
    assert same_conditions(WindowRuns(both, PRESET)) == ()
    one = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), temperature_rise=(20.0, 22.0))
    assert same_conditions(WindowRuns(one, PRESET)) == ("temperature",)
    never = decoder_data(driven_by_voltage, Z, supply=(0.99, 1.0))
    assert same_conditions(WindowRuns(never, PRESET)) == ("supply", "temperature")
