"""Voltage and temperature that a log states are the set-up, not the motor: z is the same whatever they are."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from swinging_load import swinging_load

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.grey_box_fit import adapt
from motorprior.identification.physics.fleet_fit import least_latents
from motorprior.identification.physics.term_selection import (
    FEWEST,
    same_conditions,
    segments_to_choose_by,
    select_terms,
    stretches,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS, with_what_is_stated
from motorprior.identification.residual import without_residual
from motorprior.identification.training_data.windows import SUPPLY, WARMER, TrainingData, training_data

Networks = Callable[..., LatentNetwork]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60, window=64)
Z = np.array([[0.8, -1.2, 0.4], [-0.5, 0.7, 1.1], [0.1, 0.2, -1.0]])
SETUPS = {"usual": (1.0, 0.0), "weak": (0.7, 0.0), "hot": (1.0, 40.0), "weak and hot": (0.7, 40.0)}


@pytest.fixture(scope="module")
def driven_by_voltage(grey_network: Networks) -> LatentNetwork:
    """Servos whose law commands a duty cycle, and whose torques fall by 30 % when they are 50 K warmer."""
    return grey_network(terms=("supply", "temperature"), supply_share=1.0, temperature_loss=0.3)


def under(decoder_data: Data, network: LatentNetwork, supply: float, warmer: float) -> TrainingData:
    return decoder_data(network, Z, supply=(supply,), warmer=(warmer,))


@pytest.mark.parametrize("setup", SETUPS)
def test_z_describes_the_motor_whatever_it_works_under(
    decoder_data: Data, driven_by_voltage: LatentNetwork, setup: str
):
    data = under(decoder_data, driven_by_voltage, *SETUPS[setup])
    found = adapt(driven_by_voltage, data, replace(PRESET, num_latents=3), 0.01, None)
    spread = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.all(np.abs(found.mean - Z) < np.maximum(3.0 * spread, 0.05))


@pytest.mark.parametrize(("channel", "usual", "setup"), [(SUPPLY, 1.0, "weak"), (WARMER, 0.0, "hot")])
def test_a_prior_that_ignored_them_would_take_them_for_the_motor(
    decoder_data: Data, driven_by_voltage: LatentNetwork, channel: int, usual: float, setup: str
):
    data = under(decoder_data, driven_by_voltage, *SETUPS[setup])
    ignored = data.series.copy()
    ignored[..., channel] = usual
    misled = adapt(driven_by_voltage, replace(data, series=ignored), replace(PRESET, num_latents=3), 0.01, None)
    assert np.abs(misled.mean - Z).max() > 0.3


def test_a_fit_asks_for_what_differs_between_segments_alone(decoder_data: Data, driven_by_voltage: LatentNetwork):
    both = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), warmer=(0.0, 30.0))
    assert same_conditions(WindowRuns(both, PRESET)) == ()
    one = decoder_data(driven_by_voltage, Z, supply=(0.8, 1.1, 0.9), warmer=(20.0, 22.0))
    assert same_conditions(WindowRuns(one, PRESET)) == ("temperature",)
    never = decoder_data(driven_by_voltage, Z, supply=(0.99, 1.0))
    assert same_conditions(WindowRuns(never, PRESET)) == ("supply", "temperature")


def test_a_speed_that_a_higher_voltage_gave_bounds_no_motor(decoder_data: Data, grey_network: Networks):
    limited = grey_network(
        spread=0.0, terms=("torque_speed", "supply"), supply_share=1.0, no_load_speed=4.0, stall_torque=1.5
    )
    assert limited.motor is not None
    runs = WindowRuns(decoder_data(limited, Z, 10, rows=800, supply=(0.7, 1.3)), PRESET)
    row = parameters_of(limited.motor.terms).index("no_load_speed")
    least = least_latents(limited.motor.center, limited.motor.terms, runs)[:, row]
    assert np.all(np.isfinite(least)) and np.all(least < 0.1)


@pytest.mark.parametrize("warmer", [(0.0, 60.0), (0.0, 0.0, 60.0, 60.0), (60.0, 0.0, 0.0, 0.0)])
@pytest.mark.parametrize("least", [FEWEST, segments_to_choose_by(1)])
@pytest.mark.parametrize("windows", [1, 3])
def test_what_is_fitted_and_what_is_judged_has_every_condition(
    decoder_data: Data, driven_by_voltage: LatentNetwork, warmer: tuple[float, ...], least: int, windows: int
):
    rows = PRESET.warm_up + windows * PRESET.window + 1
    runs = WindowRuns(decoder_data(driven_by_voltage, Z, 8, rows=rows, warmer=warmer), PRESET)
    assert runs.windows == 8 * windows
    hot = np.array([segment.rows[0, WARMER, 0] > 30.0 for segment in runs.segments])[runs.groups()]
    judged = stretches(runs, least) % 2 == 1
    assert all((judged[hot == each]).any() and (~judged[hot == each]).any() for each in (True, False))


@pytest.mark.slow
def test_terms_of_voltage_and_temperature_are_chosen_where_motors_have_them(
    decoder_data: Data, driven_by_voltage: LatentNetwork
):
    motors = np.random.default_rng(2).standard_normal((6, 3))
    supply, warmer = (0.7, 0.7, 1.0, 1.0), (0.0, 0.0, 60.0, 60.0, 60.0, 60.0, 0.0, 0.0)
    data = decoder_data(driven_by_voltage, motors, 16, supply=supply, warmer=warmer)
    told: list[str] = []
    chosen = select_terms(without_residual(data.scales, PRESET), WindowRuns(data, PRESET), 0, told.append)
    assert {"supply", "temperature"} <= set(chosen.terms)
    assert not any("same in all segments" in line for line in told)


def test_conditions_count_beside_the_recipes_own_as_means_of_a_segment():
    volts, degrees = np.where(np.arange(800) < 400, 8.0, 6.0)[:, None], np.linspace(20.0, 60.0, 800)[:, None]
    volts[::2] += 0.5
    volts[1::2] -= 0.5
    whole = swinging_load(800, segment=np.repeat([0, 1], 400), supply_voltage=volts, motor_temperature=degrees)
    recipe = with_what_is_stated(PRESET, whole)
    assert recipe.usual_conditions == {"motor_temperature": 40.0, "supply_voltage": 7.0}
    (_, *degrees_of_segments), (_, *volts_of_segments) = recipe.conditions
    np.testing.assert_allclose(degrees_of_segments, [30.0, 40.0, 50.0], atol=0.1)
    assert volts_of_segments == pytest.approx([6.0, 7.0, 8.0])
    series = training_data(whole, recipe, "x").series[0]
    np.testing.assert_allclose(series[:, SUPPLY], np.repeat([8 / 7, 6 / 7], 400), rtol=1e-6)
    np.testing.assert_allclose(series[:, WARMER], np.repeat([-10.0, 10.0], 400), atol=0.1)
    for plain in (training_data(whole, PRESET, "x"), training_data(swinging_load(800), recipe, "x")):
        assert np.all(plain.series[..., SUPPLY] == 1.0) and np.all(plain.series[..., WARMER] == 0.0)
