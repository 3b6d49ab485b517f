"""Fitted one by one, motors behave as they did on the bench, and their play is found."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.physical import PhysicalActuator
from motorprior.bench.dynamometer import run
from motorprior.bench.families import geared
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.identification.bench_fidelity import held_out_trials
from motorprior.identification.per_motor import fit_motors
from motorprior.identification.presets import identification_preset
from motorprior.identification.windows import training_data
from motorprior.signals import rmse

pytestmark = pytest.mark.slow
RECIPE = replace(identification_preset("per_motor"), warm_up=60, window=48)


def test_motors_are_fitted_one_by_one_with_their_play():
    fleet = load_fleet("pupper_v2")
    motors = replace(geared(fleet.center(3)), backlash=np.array([0.005, 0.02, 0.05]))
    data = training_data(record(motors, bench_preset("adapt"), 2500, 0, fleet), RECIPE, "log")
    network, mean, log_var = fit_motors(data, RECIPE)
    assert network.motor is not None and mean.shape == log_var.shape == (3, 14)
    found = network.constants(mean)
    np.testing.assert_allclose(found["backlash"], motors.backlash, rtol=0.3, atol=0.002)
    case = held_out_trials("gait", 3, 0)[0]
    truth = run(PhysicalActuator(motors), case).joint_pos
    assert rmse(run(LatentActuator(network, mean), case).joint_pos, truth, axis=0).max() < 0.01
