"""The latents of a motor do not depend on logged gains, voltage and temperature."""

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


def test_motors_with_logged_gains_equal_motors_with_these_constants(with_gains: GreyBox):
    kp, kd = SOFT[:, 0]
    center = with_gains.center.copy()
    center[INDEX] += np.log([kp, kd / kp])
    equivalent = replace(with_gains, center=center, copula=None, gain_unit="")
    with_registers = GreyBoxActuator(
        with_gains, Z, gains=np.broadcast_to(SOFT, (2, len(Z)))
    ).arrays(0.002)

    np.testing.assert_allclose(
        with_registers.parameters,
        GreyBoxActuator(equivalent, Z).arrays(0.002).parameters,
        rtol=1e-12,
    )


def test_motors_without_the_gains_that_their_model_needs_are_an_error(with_gains: GreyBox):
    with pytest.raises(ConfigError) as refusal:
        GreyBoxActuator(with_gains, Z).arrays(0.002)

    assert refusal.value.argument == "gains"


def test_z_does_not_depend_on_gains_and_load(decoder_data: Data, with_gains: GreyBox):
    posteriors = {}

    for name, gains, load in (("soft", SOFT, 1.0), ("stiff", STIFF, 1.0), ("loaded", STIFF, 1.5)):
        gains_of_motors = np.broadcast_to(gains, (2, len(Z)))
        data = decoder_data(with_gains, Z, gains=gains_of_motors, load=load)
        posteriors[name] = fit_posterior(with_gains, data, replace(PRESET, num_latents=3), 0.01)

    for name, posterior in posteriors.items():
        deviation = np.sqrt(np.diagonal(posterior.covariance, axis1=1, axis2=2))
        error = np.abs(posterior.mean - Z)
        assert np.all(error < np.maximum(3.0 * deviation, 0.05)), name


def test_only_terms_of_operating_conditions_that_vary_are_fitted(
    decoder_data: Data, grey_box: Networks
):
    """The servos command a duty cycle; their torques fall by 30 % when they are 50 K warmer."""
    box = grey_box(terms=("supply", "temperature"), supply_share=1.0, temperature_loss=0.3)

    def unvaried(supply: tuple[float, ...], rise: tuple[float, ...] = (0.0,)) -> tuple[str, ...]:
        data = decoder_data(box, Z, supply=supply, temperature_rise=rise)
        return terms_without_variation(WindowRuns(data, replace(PRESET, gain_unit="")))

    assert unvaried((0.8, 1.1, 0.9), (0.0, 30.0)) == ()
    assert unvaried((0.8, 1.1, 0.9), (20.0, 22.0)) == ("temperature",)
    assert unvaried((0.99, 1.0)) == ("supply", "temperature")


FIRMWARE = (("dead_zone", 0.002), ("profile_speed", 3.0))


def test_a_log_with_similar_or_unknown_registers_fits_the_prior():
    preset = replace(PRESET, gain_unit="", firmware=FIRMWARE)

    for firmware in ({}, {"profile_speed": 3.02}, {"profile_acceleration": 39.0}):
        training_data(swinging_load(firmware=firmware), preset, "x")


def test_a_log_of_another_firmware_is_rejected():
    preset = replace(PRESET, gain_unit="", firmware=FIRMWARE)
    log = swinging_load(firmware={"profile_speed": 4.0})

    with pytest.raises(LogError, match=r"firmware\.profile_speed 4 and 3") as refusal:
        training_data(log, preset, "x")

    assert refusal.value.where == "x"


def test_the_logged_side_of_the_encoder_is_not_selected():
    on_output, on_rotor = (
        replace(PRESET, firmware=(("output_encoder", side),)) for side in (1.0, 0.0)
    )

    assert on_output.logged_terms == ("output_encoder",)
    assert on_rotor.logged_terms == ()
    assert on_rotor.disabled_terms == ("output_encoder",)
