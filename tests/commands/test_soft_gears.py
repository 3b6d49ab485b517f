"""Gears that suspended logs make too soft to carry a robot are named."""

from dataclasses import replace

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.priors.prior_file import soft_gear_notes


@pytest.mark.parametrize(("stiffness", "is_noted"), [(60.0, True), (400.0, False)])
def test_a_gear_about_as_soft_as_the_position_gain_is_noted(stiffness: float, is_noted: bool):
    # with 60 N·m/rad a quadruped of this card falls, with 400 it does not (docs/go2.md)
    prior = mp.from_pretrained("go2")
    calf = replace(prior, model=with_gear(prior.model, stiffness)).training_motors(np.array([2]))

    notes = list(soft_gear_notes(calf, ["calf"]))

    assert bool(notes) == is_noted
    assert all("calf is 1.5 times its position gain" in note for note in notes)


def with_gear(model, stiffness: float):
    """The model with one stiffness of all gears [N·m/rad]."""
    is_stiffness = np.array([name == "gear_stiffness" for name in PARAMETERS])
    center = np.where(is_stiffness, np.log(stiffness), model.center)
    return replace(model, center=center, slope=np.where(is_stiffness, 0.0, model.slope))
