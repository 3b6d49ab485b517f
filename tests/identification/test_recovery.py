"""A prior and `fit_posterior` recover the constant that varies between the motors of a fleet.

There are four fleets; one constant varies in each.
"""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.physical import PhysicalMotors
from motorprior.bench.recording import BENCH_SCHEDULES, record
from motorprior.identification.identify import identify
from motorprior.identification.latents.latent_fit import LatentPosterior, fit_posterior
from motorprior.identification.presets import identification_preset
from motorprior.identification.training_result import TrainingResult
from motorprior.identification.windows import training_data
from motorprior.logs.motor_log import MotorLog

pytestmark = pytest.mark.slow
FLEET = load_fleet("pupper_v2")
# constant -> its smallest and largest factor
RANGES = {"armature": (0.4, 3.0), "coulomb": (0.3, 3.0), "kp": (0.6, 1.6), "backlash": (0.3, 3.0)}
# motors per constant
TRAINED = 10
NEW = 5
BENCH = replace(BENCH_SCHEDULES["adapt"], load_inertia=(1e-4, 5e-3))
RECIPE = replace(identification_preset("rollout"), tries_terms=False)


def fleets(count: int, seed: int) -> PhysicalMotors:
    """``count`` motors per constant of RANGES, in that order.

    Their other constants are those of the central motor.
    """
    motors = require_geared(FLEET.center(count * len(RANGES)))
    rng = np.random.default_rng(seed)
    changes = {}

    for group, (name, (low, high)) in enumerate(RANGES.items()):
        factors = np.ones(len(motors))
        logarithms = np.linspace(np.log(low), np.log(high), count)
        factors[group * count : (group + 1) * count] = np.exp(rng.permutation(logarithms))
        changes[name] = getattr(motors, name) * factors
        if name == "kp":
            changes["kd"] = motors.kd * factors

    return replace(motors, **changes)


@pytest.fixture(scope="module")
def log() -> MotorLog:
    return record(fleets(TRAINED, 1), BENCH, 2500, 0, FLEET)


@pytest.fixture(scope="module")
def prior(log: MotorLog) -> TrainingResult:
    return identify(training_data(log, RECIPE, "log"), RECIPE, 0)


@pytest.fixture(scope="module")
def posterior(log: MotorLog, prior: TrainingResult) -> LatentPosterior:
    """Posteriors of new motors of the four fleets, from 10 s of log each."""
    scales = training_data(log, RECIPE, "log").scales
    new_log = record(fleets(NEW, 2), BENCH, 5000, 7, FLEET)
    data = replace(training_data(new_log, RECIPE, "log"), scales=scales)

    return fit_posterior(prior.model, data, RECIPE, float(prior.losses[-1]))


@pytest.mark.parametrize(
    ("name", "bound"), [("armature", 0.12), ("kp", 0.05), ("coulomb", 0.25), ("backlash", 0.25)]
)
def test_adapt_recovers_the_varying_constant(
    prior: TrainingResult, posterior: LatentPosterior, name: str, bound: float
):
    """The root mean square of log(decoded / true) is bounded; 0.2 is an error of 20 %.

    The prior is trained in seconds.
    """
    assert isinstance(prior.model, GreyBox)
    group = list(RANGES).index(name)
    rows = slice(group * NEW, (group + 1) * NEW)
    decoded = prior.model.constants(posterior.mean)[name][rows]
    true = getattr(fleets(NEW, 2), name)[rows]

    assert np.sqrt(np.mean(np.log(decoded / true) ** 2)) < bound
