"""What a log states of a servo's firmware, from the fit of a prior to its recipe, its motors and other logs."""

import io
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import adapt_to
from motorprior.pipeline.identify import fit_prior
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.recipe import recipe_of

PATH = Path("prior.safetensors")


def log(**firmware: float) -> MotorLog:
    """A joint that follows its command a little late."""
    time = 0.002 * np.arange(900)
    angle = np.sin(9.0 * time)[:, None]
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m", source="s",
        load_inertia=np.full_like(angle, 0.01), external_torque=0.0 * angle, firmware=firmware,
    )  # fmt: skip


def test_a_stated_register_is_the_motors_in_recipe_prior_and_posterior():
    said = io.StringIO()
    prior = fit_prior(log(profile_acceleration=39.0), "pace", progress=Lines(said))
    assert "terms beyond the geared motor: profile (stated)" in said.getvalue().splitlines()
    assert prior.network.motor is not None and prior.network.motor.terms == ("profile",)
    assert recipe_of(prior, PATH).firmware == (("profile_acceleration", 39.0),)
    told = log(profile_acceleration=38.9631)
    found = adapt_to(prior, PATH, told, "told")
    for z in (prior.mean, found.mean):
        assert prior.network.constants(z)["profile_acceleration"] == pytest.approx(39.0, rel=1e-4)
    with pytest.raises(LogError, match=r"told: firmware\.profile_acceleration 20 and 39, the prior's"):
        adapt_to(prior, PATH, log(profile_acceleration=20.0), "told")
