"""What the recording of a hung robot says of its motors: virtual Puppers, whose motors are known."""

from dataclasses import replace

import numpy as np
import pytest

from closing_the_loop import VirtualRobot, record
from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import PARAMETERS, ZERO_SCALE
from motorprior.actuator.physical import MotorParameters
from motorprior.bench.distribution import Distribution
from motorprior.bench.fleet import load_fleet
from motorprior.identification.latents.latent_fit import Posterior, adapt
from motorprior.identification.networks.network import export, initial_parameters
from motorprior.identification.presets import identification_preset
from motorprior.identification.training_data.windows import training_data
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.pipeline.twin_body import draw_motors
from motorprior.robots.pupper_v2.robot import PUPPER_V2

pytestmark = pytest.mark.slow
RECIPE = identification_preset("rollout")
FLEET = load_fleet("pupper_v2")
TEMPERATURE = 0.109
"""Mean window loss, without torques, of a prior of 32 such motors on these (`loss_mean_without_torque`)."""
NARROWEST = 0.05
ROBOT, SECONDS = 0, 20.0


def logarithm(one: Distribution, zero: bool) -> tuple[float, float]:
    """Center and deviation of a constant of the fleet, as a grey box counts it."""
    values = one.values
    spread = float(np.hypot(values.get("spread", 0.0), values.get("center_uncertainty", 0.0)))
    if zero:
        return one.center / ZERO_SCALE, spread / ZERO_SCALE
    if one.kind == "uniform":
        spread = float(np.log(values["high"] / values["low"]) / np.sqrt(12.0))
    elif one.kind == "normal":
        spread /= one.center
    return float(np.log(one.center)), max(spread, NARROWEST)


@pytest.fixture(scope="module")
def known() -> GearedMotor:
    """A decoder that knows the fleet, one latent per constant; no training can do better."""
    center, spread = np.array([logarithm(FLEET.parameters[name], name == "encoder_zero") for name in PARAMETERS]).T
    return GearedMotor(center, np.diag(spread))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, known: GearedMotor) -> Posterior:
    log = read_parquet(record(VirtualRobot(ROBOT), tmp_path_factory.mktemp("robot"), SECONDS, "varied"))
    assert log.encoder == "rotor", "a Pupper's"
    data = training_data(log, RECIPE, "log")
    silent = export(initial_parameters(np.random.default_rng(0), RECIPE), RECIPE, data.scales)
    return adapt(replace(silent, motor=known), data, RECIPE, TEMPERATURE)


@pytest.fixture(scope="module")
def truth(known: GearedMotor) -> np.ndarray:
    """(12, P) the motors' own latents."""
    motors: MotorParameters = draw_motors(PUPPER_V2, FLEET, ROBOT)
    values = {name: getattr(motors, name) for name in PARAMETERS if name != "kd_over_kp"}
    values["kd_over_kp"] = motors.kd / motors.kp
    raw = [values[name] / ZERO_SCALE if name == "encoder_zero" else np.log(values[name] + 1e-9) for name in PARAMETERS]
    return (np.array(raw).T - known.center) / np.diagonal(known.slope)


@pytest.mark.parametrize(("name", "least"), [("coulomb", 0.9), ("kd_over_kp", 0.8), ("kp", 0.4)])
def test_friction_and_gains_are_found(found: Posterior, truth: np.ndarray, name: str, least: float):
    row = PARAMETERS.index(name)
    assert np.corrcoef(found.mean[:, row], truth[:, row])[0, 1] > least
    assert np.sqrt(np.mean((found.mean - truth)[:, row] ** 2)) < np.sqrt(np.mean(truth[:, row] ** 2)), (
        "than the fleet's"
    )


@pytest.mark.parametrize("name", ["backlash", "encoder_zero"])
def test_what_a_rotor_does_not_see_stays_the_fleets(found: Posterior, name: str):
    row = PARAMETERS.index(name)
    assert np.abs(found.mean[:, row]).max() < 0.2
    assert found.covariance[:, row, row].min() > 0.9
