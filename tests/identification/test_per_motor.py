"""Fitted one by one, motors of the very kind that is fitted are found again."""

from dataclasses import replace

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.record import bench_preset, record
from motorprior.identification.per_motor import fit_motors
from motorprior.identification.presets import identification_preset
from motorprior.identification.validate import held_out_trials
from motorprior.identification.windows import training_data
from motorprior.signals import rmse

MOTORS = 3
RECIPE = replace(identification_preset("per_motor"), warm_up=30, window=32)


def test_motors_are_fitted_one_by_one_with_their_play():
    fleet = load_fleet("pupper_v2")
    motors = fleet.center(MOTORS)
    motors = replace(motors, backlash=np.array([0.005, 0.02, 0.05]), kp=motors.kp * np.array([0.8, 1.0, 1.2]))
    data = training_data(record(motors, bench_preset("adapt"), 2500, 0, fleet), RECIPE, "log")
    network, mean, log_var = fit_motors(data, RECIPE)
    assert network.motor is not None and mean.shape == log_var.shape == (MOTORS, 14)
    found = network.motor.decode(mean)
    np.testing.assert_allclose(found["kp"], motors.kp, rtol=0.15)
    np.testing.assert_allclose(found["backlash"], motors.backlash, rtol=0.3, atol=0.002)
    # nobody's log is in another's constants: alone, a motor has the same
    alone = fit_motors(replace(data, series=data.series[:1]), RECIPE)
    assert alone[0].motor is not None
    np.testing.assert_allclose(alone[0].motor.decode(alone[1])["kp"], found["kp"][:1], rtol=0.02)
    from motorprior.actuator.physical import PhysicalActuator

    case = held_out_trials("impacts", MOTORS, 0)[0]
    error = rmse(run(LatentActuator(network, mean), case).joint_pos, run(PhysicalActuator(motors), case).joint_pos)
    assert error < 0.01
