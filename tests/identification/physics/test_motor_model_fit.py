"""Motors of one model: a motor under load tells the others its constants."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.physics.motor_fit import fit_motors
from motorprior.identification.physics.motor_model_fit import model_level, sibling_deviations
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData
from motorprior.robots.motor_models import MotorModel, StatedValue

Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60, grey_boxes="together")
MOTORS = 4
KP = PARAMETERS.index("kp")
LIMIT = PARAMETERS.index("torque_limit")


def box_with_limit(limit: float) -> GreyBox:
    center = initial_center(())
    center[LIMIT] = np.log(limit)
    return grey_box(center, (), PRESET)


def true_offsets() -> np.ndarray:
    """(MOTORS, K) constants of motors of one model, relative to its mean."""
    offsets = np.zeros((MOTORS, len(PARAMETERS)))
    offsets[:, KP] = [-0.05, 0.05, 0.0, 0.08]
    return offsets


def with_models(data: TrainingData, model: MotorModel) -> TrainingData:
    return replace(data, motor_models=(model,) * MOTORS)


def test_a_limit_that_no_log_reaches_is_what_the_maker_states(decoder_data: Data):
    box = box_with_limit(60.0)
    data = with_models(
        decoder_data(box, true_offsets(), segments=5, rows=400),
        MotorModel("M1", torque_limit=StatedValue(40.0, 0.1)),
    )

    fits = fit_motors(WindowRuns(data, PRESET), (), True, 0, restarts=8)

    np.testing.assert_allclose(np.exp(fits.outputs[:, LIMIT]), 40.0, rtol=0.1)
    expected = box.center[KP] + true_offsets()[:, KP]
    np.testing.assert_allclose(fits.outputs[:, KP], expected, atol=0.05)


def test_a_constant_that_its_siblings_contradict_is_an_outlier():
    models = (MotorModel("M1"),) * MOTORS
    fixed = np.zeros(len(PARAMETERS), bool)
    level = model_level(models, np.zeros(len(PARAMETERS)), (), "", fixed)
    assert level is not None
    x = true_offsets()
    x[2, KP] = 1.0

    deviations = sibling_deviations(level, x, fixed)

    assert np.argwhere(deviations).tolist() == [[2, KP]]
    assert deviations[2, KP] == pytest.approx(1.0 - 0.05)  # 0.05 is the median of the others


def test_a_gear_scales_the_constants_of_its_motor():
    models = (MotorModel("M1"), MotorModel("M1", gear=2.0))
    fixed = np.zeros(len(PARAMETERS), bool)
    level = model_level(models, np.zeros(len(PARAMETERS)), (), "", fixed)
    assert level is not None

    assert level.shift[1, PARAMETERS.index("armature")] == pytest.approx(np.log(4.0))
    assert level.shift[1, LIMIT] == pytest.approx(np.log(2.0))
