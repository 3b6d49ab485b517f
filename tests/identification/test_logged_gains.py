"""Logged gains, voltage and temperature do not change z."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from motor_logs import swinging_load

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.latents.latent_fit import fit_posterior
from motorprior.identification.physics.term_selection import terms_without_variation
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData, training_data
from motorprior.logs.motor_log import PHYSICAL_GAINS

Networks = Callable[..., GreyBox]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60, window=64, gain_unit=PHYSICAL_GAINS)
Z = np.array([[0.8, -1.2, 0.4], [-0.5, 0.7, 1.1], [0.1, 0.2, -1.0]])
SOFT = np.array([[9.0], [0.7]])
STIFF = np.array([[16.0], [0.9]])
INDEX = [PARAMETERS.index(name) for name in ("kp", "kd_over_kp")]


@pytest.fixture(scope="module")
def with_gains(grey_box: Networks) -> GreyBox:
    """Motors with logged gains."""
    box = grey_box(kp=1.0, kd_over_kp=1.0)
    slope = box.slope.copy()
    slope[:, INDEX] = 0.0
    return replace(box, slope=slope, gain_unit=PHYSICAL_GAINS)


def test_motors_with_logged_gains_are_motors_with_these_constants(with_gains: GreyBox):
    kp, kd = SOFT[:, 0]
    center = with_gains.center.copy()
    center[INDEX] += np.log([kp, kd / kp])
    own = replace(with_gains, center=center, copula=None, gain_unit="")
    given = GreyBoxActuator(with_gains, Z, gains=np.broadcast_to(SOFT, (2, len(Z)))).arrays(0.002)
    np.testing.assert_allclose(
        given.parameters, GreyBoxActuator(own, Z).arrays(0.002).parameters, rtol=1e-12
    )
    with pytest.raises(ConfigError, match="logged gains"):
        GreyBoxActuator(with_gains, Z).arrays(0.002)


def test_z_does_not_depend_on_gains_and_load(decoder_data: Data, with_gains: GreyBox):
    found = {}
    for name, gains, load in (("soft", SOFT, 1.0), ("stiff", STIFF, 1.0), ("loaded", STIFF, 1.5)):
        data = decoder_data(with_gains, Z, gains=np.broadcast_to(gains, (2, len(Z))), load=load)
        found[name] = fit_posterior(with_gains, data, replace(PRESET, num_latents=3), 0.01)
    for name, posterior in found.items():
        spread = np.sqrt(np.diagonal(posterior.covariance, axis1=1, axis2=2))
        assert np.all(np.abs(posterior.mean - Z) < np.maximum(3.0 * spread, 0.05)), name


def test_only_conditions_that_differ_between_segments_are_fitted(
    decoder_data: Data, grey_box: Networks
):
    """Servos that command a duty cycle, with torques that fall by 30 % when they are 50 K warmer."""
    box = grey_box(terms=("supply", "temperature"), supply_share=1.0, temperature_loss=0.3)

    def same(supply: tuple[float, ...], rise: tuple[float, ...] = (0.0,)) -> tuple[str, ...]:
        data = decoder_data(box, Z, supply=supply, temperature_rise=rise)
        return terms_without_variation(WindowRuns(data, replace(PRESET, gain_unit="")))

    assert same((0.8, 1.1, 0.9), (0.0, 30.0)) == ()
    assert same((0.8, 1.1, 0.9), (20.0, 22.0)) == ("temperature",)
    assert same((0.99, 1.0)) == ("supply", "temperature")


def test_a_log_of_another_firmware_is_rejected_and_one_without_registers_is_not():
    preset = replace(PRESET, gain_unit="", firmware=(("dead_zone", 0.002), ("profile_speed", 3.0)))
    for firmware in ({}, {"profile_speed": 3.02}, {"profile_acceleration": 39.0}):
        training_data(swinging_load(firmware=firmware), preset, "x")
    with pytest.raises(LogError, match=r"x: firmware\.profile_speed 4 and 3 \(log and prior\)"):
        training_data(swinging_load(firmware={"profile_speed": 4.0}), preset, "x")
