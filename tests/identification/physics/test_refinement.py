"""Refinement on longer free runs recovers constants that were off."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.identification.physics.motor_problem import grey_box, initial_center, motor_search
from motorprior.identification.physics.refinement import longer_runs, refined
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

PRESET = replace(PRESETS["per_motor"], warm_up=60)
KP = PARAMETERS.index("kp")
LOAD_FRICTION = PARAMETERS.index("load_friction")


@pytest.mark.parametrize("together", [False, True])
def test_refinement_recovers_constants_that_were_off(
    decoder_data: Callable[..., TrainingData], together: bool
):
    center = initial_center(())
    center[PARAMETERS.index("velocity_filter")] = np.log(3e-3)
    box = grey_box(center, (), PRESET)
    truth = np.zeros((2, box.num_latents))
    truth[:, KP] = (0.2, -0.1)
    truth[:, LOAD_FRICTION] = (-0.3, 0.4)
    data = decoder_data(box, truth, segments=6, rows=700)
    longer = longer_runs(data, PRESET, WindowRuns(data, PRESET))

    start = truth.copy()
    start[:, KP] += 0.1
    start[:, LOAD_FRICTION] -= 0.2
    z = refined(box, start, longer, together)

    search = motor_search(box, longer)
    assert (search.losses(z) < 0.2 * search.losses(start)).all()
    error = np.abs(z - truth)
    assert error[:, KP].max() < 0.02
    assert error[:, LOAD_FRICTION].max() < 0.1
