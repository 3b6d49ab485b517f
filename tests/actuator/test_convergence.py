"""A grey box with a motor's true constants converges to that motor as its steps shrink."""

from dataclasses import replace

import numpy as np
import pytest

from exports import true_grey_box
from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.physical import PhysicalActuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.recording import bench_trial
from motorprior.signals import rms
from virtual_fleets.held_out_trials import HELD_OUT

MOTORS = 16


def trial_with(excitation_name: str) -> Trial:
    rng = np.random.default_rng(5)
    steps = HELD_OUT.segment_steps
    return bench_trial(rng, excitation_name, steps, MOTORS, HELD_OUT, hold=False)


def motors():
    return require_geared(load_fleet("mixed").sample(MOTORS, np.random.default_rng(0)))


def simulated(actuator: GreyBoxActuator, trial: Trial, substeps: int) -> np.ndarray:
    """Joint positions at the trial's own times, simulated in steps of dt / substeps."""
    fine = Trial(
        np.repeat(trial.position_target, substeps, axis=0),
        np.repeat(trial.external_torque, substeps, axis=0),
        trial.load_inertia,
        trial.dt / substeps,
    )
    return run(actuator, fine).joint_pos[::substeps]


def median_rms(pos: np.ndarray, reference_pos: np.ndarray) -> float:
    """Median over motors of the RMS difference [mrad]."""
    return 1e3 * float(np.median(rms(pos - reference_pos, axis=0)))


@pytest.mark.parametrize("excitation_name", ["gait", "impacts"])
def test_halving_the_step_halves_the_error_and_leads_to_the_physical_motor(excitation_name: str):
    """Steps of 2 ms to 0.125 ms.

    Measured: errors fall by factors of 2.3 to 3.4 per halving. An error of 0.2 mrad is left,
    because the physical bench has a step, too.
    """
    trial = trial_with(excitation_name)
    actuator = true_grey_box(motors())

    finest = simulated(actuator, trial, 16)
    errors = [median_rms(simulated(actuator, trial, substeps), finest) for substeps in (1, 2, 4)]

    assert errors[0] > 1.9 * errors[1]
    assert errors[1] > 1.9 * errors[2]
    physical = run(PhysicalActuator(motors()), trial).joint_pos
    assert median_rms(finest, physical) < 0.3


def test_a_gear_that_is_too_stiff_for_the_step_acts_like_a_stiff_one():
    """The gear is softened for steps of 2 ms; encoders do not read most of the added twist.

    Measured RMS error: median 0.15 mrad, maximum 0.51 mrad. If encoders read that twist:
    0.22 mrad and 0.59 mrad.
    """
    actuator = true_grey_box(motors())
    trial = trial_with("gait")
    rows = np.array(PARAMETERS)
    center = actuator.model.center.copy()
    slope = actuator.model.slope.copy()

    for name, value in {"gear_stiffness": 1e5, "backlash": 1e-6}.items():
        center[rows == name] = np.log(value)
        slope[:, rows == name] = 0.0

    stiff = replace(actuator, model=replace(actuator.model, center=center, slope=slope))
    errors = rms(simulated(stiff, trial, 1) - simulated(stiff, trial, 16), axis=0)

    assert np.median(errors) < 0.18e-3
    assert errors.max() < 0.55e-3
