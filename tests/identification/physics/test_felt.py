"""A log feels the constants that move its joint, and no others."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.identification.physics.felt import felt_constants, limits_not_felt
from motorprior.identification.physics.initial_motor import INITIAL_MOTOR, encoded, with_motor
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.residual import without_residual
from motorprior.identification.training_data.windows import POS, VEL, TrainingData

SCALES = {"error_scale": 0.1, "velocity_scale": 2.0, "torque_scale": 0.3, "torque_limit": 3.0}
PRESET = replace(PRESETS["per_motor"], warm_up=60)


def test_of_one_motor_with_wide_limits_and_no_play(decoder_data: Callable[..., TrainingData]):
    center = encoded(INITIAL_MOTOR | {"torque_limit": 100.0, "backlash": 1e-7}, ())
    network = with_motor(without_residual(SCALES, replace(PRESET, num_latents=len(center))), center, ())
    z = np.zeros((1, len(center)))
    data = decoder_data(network, z, segments=5, rows=400)
    series = data.series.copy()
    noise = np.random.default_rng(0).standard_normal((*series.shape[:2], 2)) * [3e-4, 0.02]
    series[..., [POS, VEL]] += noise.astype(np.float32)
    felt = felt_constants(network, WindowRuns(replace(data, series=series), PRESET), z, PARAMETERS[:-1])
    assert {"kp", "kd_over_kp", "delay", "armature", "coulomb"} <= felt
    assert not {"torque_limit", "backlash"} & felt
    runs = WindowRuns(replace(data, series=series), PRESET)
    (found,) = limits_not_felt(network, runs, z).items()
    assert found[0] == "torque_limit" and found[1].motors == 1 and found[1].most == pytest.approx(100.0)
    stated = WindowRuns(replace(data, series=series), replace(PRESET, lacks=("torque_limit",)))
    assert limits_not_felt(network, stated, z) == {}
