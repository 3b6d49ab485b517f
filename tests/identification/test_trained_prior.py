"""A prior that is trained to the end follows its motors, knows the fleet's, and recognises outliers."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.physical import MotorParameters
from motorprior.bench.families import geared
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.identification.judging.bench_fidelity import Prediction, bench_errors
from motorprior.identification.latents.latent_fit import adapt, window_losses
from motorprior.identification.latents.outliers import Outliers, latent_names, outliers
from motorprior.identification.presets import identification_preset
from motorprior.identification.train import Identified, identify
from motorprior.identification.training_data.windows import training_data
from motorprior.pipeline.motor_choice import nominal_pd

pytestmark = pytest.mark.slow
RECIPE = replace(identification_preset("rollout"), steps=1500, batch=128, warm_up=90)
"""The training motors must be where they belong: their spread is the yardstick."""
CHANGES = (("kp", 2.5), ("kd", 0.25))


def motors() -> MotorParameters:
    return geared(load_fleet("mixed").sample(16, np.random.default_rng(3)))


@pytest.fixture(scope="module")
def prior() -> tuple[Identified, float]:
    log = record(motors(), PRESETS["rollout"], 5000, 3, load_fleet("mixed"))
    data = training_data(log, RECIPE, "log")
    found = identify(data, RECIPE, 0)
    return found, float(window_losses(found.network, data, RECIPE, found.mean).mean())


@pytest.fixture(scope="module")
def judged(prior: tuple[Identified, float]) -> Outliers:
    """Six motors of the fleet, then one for each of CHANGES: 10 s of log."""
    found, temperature = prior
    fleet = load_fleet("mixed")
    new = fleet.sample(6 + len(CHANGES), np.random.default_rng(8))
    for row, (name, factor) in enumerate(CHANGES, start=6):
        values = getattr(new, name).copy()
        values[row] = factor * getattr(fleet.center(1), name)[0]
        new = replace(new, **{name: values})
    data = training_data(record(new, PRESETS["adapt"], 5000, 9, fleet), RECIPE, "log")
    modes = adapt(found.network, data, RECIPE, temperature).mean
    return outliers(found.network, found.mean, modes, data, RECIPE, temperature)


@pytest.mark.parametrize("kind", ["impacts", "chirp"])
def test_its_motors_are_followed_three_times_as_closely_as_by_an_ideal_pd(prior: tuple[Identified, float], kind: str):
    """Measured: 0.06 with the preset's own steps."""
    found, pd = prior[0], nominal_pd(load_fleet("mixed"), 16)
    models: dict[str, Prediction] = {
        "prior": lambda index: LatentActuator(found.network, found.mean[index]),
        "pd": lambda index: pd,
    }
    errors = {name: np.median(values) for name, values in bench_errors(motors(), models, 5)[kind].items()}
    assert errors["prior"] < 0.3 * errors["pd"]


def test_motors_of_the_fleet_are_like_it(judged: Outliers):
    assert np.all(judged.p_value[:6] > 0.01)


@pytest.mark.parametrize(("row", "name", "sign"), [(6, "kp", 1.0), (7, "kd_over_kp", -1.0)])
def test_a_constant_far_outside_is_seen_and_named(judged: Outliers, row: int, name: str, sign: float):
    assert judged.latent[row] == name
    assert sign * judged.deviation[row] > 3.0
    assert judged.p_value[row] < 0.05


def test_latents_are_named_after_constants_where_each_has_one(prior: tuple[Identified, float]):
    network = prior[0].network
    assert network.motor is not None and latent_names(network) == parameters_of(network.motor.terms)
    assert latent_names(replace(network, motor=None))[:2] == ("latent 0", "latent 1")
