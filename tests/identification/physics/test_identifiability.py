"""Constants that move the joint of a log are identifiable, others are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.identification.physics.motor_problem import (
    INITIAL_MOTOR,
    TORQUES,
    encoded,
    grey_box,
    identifiable_constants,
    unidentifiable_limits,
    unknown_torque_scale,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import POS, VEL, TrainingData
from motorprior.logs.motor_log import PHYSICAL_GAINS

PRESET = replace(PRESETS["per_motor"], warm_up=60)


def test_of_one_motor_with_wide_limits_and_no_play(decoder_data: Callable[..., TrainingData]):
    center = encoded(INITIAL_MOTOR | {"torque_limit": 100.0, "backlash": 1e-7}, ())
    box = grey_box(center, (), PRESET)
    z = np.zeros((1, len(center)))
    data = decoder_data(box, z, segments=5, rows=400)
    series = data.series.copy()
    noise = np.random.default_rng(0).standard_normal((*series.shape[:2], 2)) * [3e-4, 0.02]
    series[..., [POS, VEL]] += noise.astype(np.float32)
    found = identifiable_constants(
        box, WindowRuns(replace(data, series=series), PRESET), z, PARAMETERS[:-1]
    )
    assert {"kp", "kd_over_kp", "delay", "armature", "coulomb"} <= found
    assert not {"torque_limit", "backlash"} & found
    runs = WindowRuns(replace(data, series=series), PRESET)
    (limit,) = unidentifiable_limits(box, runs, z).items()
    assert limit[0] == "torque_limit" and limit[1].tolist() == [True]
    stated = WindowRuns(replace(data, series=series), replace(PRESET, lacks=("torque_limit",)))
    assert unidentifiable_limits(box, stated, z) == {}


@pytest.mark.parametrize(("size", "noise", "hidden"), [(1.0, 0.02, False), (10.0, 0.02, True)])
def test_the_scale_of_torques_is_unknown_where_noise_hides_the_effect_of_the_load(
    decoder_data: Callable[..., TrainingData], size: float, noise: float, hidden: bool
):
    motor = INITIAL_MOTOR | {
        name: size * INITIAL_MOTOR[name] for name in TORQUES if name in INITIAL_MOTOR
    }
    box = grey_box(encoded(motor, ()), (), PRESET)
    z = np.zeros((1, len(PARAMETERS)))
    data = replace(decoder_data(box, z, segments=5, rows=400), has_torque=False)
    series = data.series.copy()
    series[..., POS] += (noise * np.random.default_rng(0).standard_normal(series.shape[:2])).astype(
        np.float32
    )
    data = replace(data, series=series)
    assert unknown_torque_scale(box, WindowRuns(data, PRESET), z).tolist() == [hidden]
    stated = WindowRuns(data, replace(PRESET, gain_unit=PHYSICAL_GAINS))
    assert not unknown_torque_scale(replace(box, gain_unit=PHYSICAL_GAINS), stated, z).any(), (
        "gains set the scale"
    )
    apart = np.concatenate([z, z + 2.0 * np.isin(PARAMETERS, "kp")])
    both = WindowRuns(decoder_data(box, apart, segments=5, rows=400), PRESET)
    assert unknown_torque_scale(box, both, apart + 0.01).all(), (
        "kp of one class differs by a factor of seven"
    )
