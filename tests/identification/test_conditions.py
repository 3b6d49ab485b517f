"""Logged voltage and temperature do not change z."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics.term_selection import same_conditions
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

Networks = Callable[..., GreyBox]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60, window=64)
Z = np.array([[0.8, -1.2, 0.4], [-0.5, 0.7, 1.1], [0.1, 0.2, -1.0]])


@pytest.fixture(scope="module")
def driven_by_voltage(grey_box: Networks) -> GreyBox:
    """Servos that command a duty cycle, with torques that fall by 30 % when they are 50 K warmer."""
    return grey_box(terms=("supply", "temperature"), supply_share=1.0, temperature_loss=0.3)


def test_only_conditions_that_differ_between_segments_are_fitted(decoder_data: Data, driven_by_voltage: GreyBox):
    both = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), temperature_rise=(0.0, 30.0))
    assert same_conditions(WindowRuns(both, PRESET)) == ()
    one = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), temperature_rise=(20.0, 22.0))
    assert same_conditions(WindowRuns(one, PRESET)) == ("temperature",)
    never = decoder_data(driven_by_voltage, Z, supply=(0.99, 1.0))
    assert same_conditions(WindowRuns(never, PRESET)) == ("supply", "temperature")
