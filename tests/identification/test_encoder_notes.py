"""A kp that depends on the place of the encoder is named, unless the logs state the place."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification import windows as channel
from motorprior.identification.fit_notes import encoder_notes
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

NONE_FIXED = np.zeros(len(PARAMETERS), bool)
GIVEN_KP = np.array([name == "kp" for name in PARAMETERS])


def a_model(kp: float, stiffness: float) -> GreyBox:
    """The model of a card, with one kp and one stiffness of all motors [N·m/rad]."""
    model = mp.from_pretrained("pupper_v2").model
    assert isinstance(model, GreyBox)
    values = {"kp": kp, "gear_stiffness": stiffness}
    is_set = np.array([name in values for name in PARAMETERS])
    logs = np.array([np.log(values.get(name, 1.0)) for name in PARAMETERS])
    return replace(
        model,
        center=np.where(is_set, logs, model.center),
        slope=np.where(is_set, 0.0, model.slope),
    )


def data_of(register: float = 1.0, **fields: Any) -> TrainingData:
    """A log of one motor whose logged kp is ``register``."""
    series = np.zeros((1, 10, channel.CHANNELS), np.float32)
    series[..., channel.KP] = register
    return TrainingData(series, np.zeros(1), (slice(0, 10),), {}, False, **fields)


@pytest.mark.parametrize(("kp", "register"), [(10.0, 1.0), (0.5, 20.0)])
def test_the_warning_states_how_much_lower_kp_is_at_the_output(kp: float, register: float):
    model = a_model(kp, 90.0)

    z = np.zeros((1, len(PARAMETERS)))

    (note,) = encoder_notes(model, z, data_of(register), PRESETS["quick"], NONE_FIXED)

    # 10 N·m/rad and 90 N·m/rad in series are 9 N·m/rad
    assert "is 10 % lower" in note.text
    assert "output_encoder" in note.text


def test_rows_without_position_control_do_not_count():
    z = np.zeros((1, len(PARAMETERS)))
    data = data_of(20.0)
    frames = np.ones((1, 10, channel.FRAME_CHANNELS), np.float32)
    series = np.concatenate([data.series, frames], axis=2)
    series[:, 3:, channel.KP] = 1.0
    series[:, 3:, channel.KP_FACTOR] = 0.0

    model = a_model(0.5, 90.0)
    passive = replace(data, series=series)
    (note,) = encoder_notes(model, z, passive, PRESETS["quick"], NONE_FIXED)

    assert "is 10 % lower" in note.text


@pytest.mark.parametrize(
    ("stiffness", "fields", "fixed"),
    [
        (4000.0, {}, NONE_FIXED),
        (90.0, {"at_rotor": True}, NONE_FIXED),
        (90.0, {"command_mode": "mit"}, NONE_FIXED),
        (90.0, {}, GIVEN_KP),
    ],
)
def test_there_is_no_warning_where_the_place_does_not_matter(
    stiffness: float, fields: dict[str, Any], fixed: np.ndarray
):
    model = a_model(10.0, stiffness)

    z = np.zeros((1, len(PARAMETERS)))

    assert not encoder_notes(model, z, data_of(**fields), PRESETS["quick"], fixed)


@pytest.mark.parametrize("place", [0.0, 1.0])
def test_there_is_no_warning_where_the_logs_state_the_place(place: float):
    recipe = replace(PRESETS["quick"], firmware=(("output_encoder", place),))
    z = np.zeros((1, len(PARAMETERS)))

    assert not encoder_notes(a_model(10.0, 90.0), z, data_of(), recipe, NONE_FIXED)
