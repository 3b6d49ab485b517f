"""PDs fitted to a log that a PD made are that PD, and say what it took."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.bench.dynamometer import run
from motorprior.bench.facts import training_motors
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.identification.baselines.pd_fit import PdFit, beginnings, fit_to_the_end, pd_motors
from motorprior.identification.baselines.replay_error import trials
from motorprior.identification.baselines.tuned_pds import EVERYTHING, FRICTION, GAINS
from motorprior.logs.motor_log import MotorLog
from motorprior.studies.conditions import LAGS

TRUE = {"kp": 7.0, "kd": 0.7, "torque_limit": 1.2, "armature": 0.004, "delay": 0.004, "coulomb": 0.15}
START = {"kp": 8.8, "kd": 0.84, "torque_limit": 1.26}
MOTORS = 4


@pytest.fixture(scope="module")
def log() -> MotorLog:
    """A bench log whose motions are those of a PD with friction."""
    fleet = load_fleet("pupper_v2")
    made = record(training_motors(fleet, MOTORS, 0), bench_preset("rollout"), 5000, 0, fleet)
    motors = pd_motors(TRUE, MOTORS)
    return replace(made, joint_pos=np.concatenate([run(motors, trial).joint_pos for trial, _ in trials(made)]))


def fitted(log: MotorLog, free: tuple[str, ...]) -> tuple[PdFit, int]:
    counts = []
    return fit_to_the_end(log, beginnings(START, free, LAGS), free, counts.append), sum(counts)


def test_the_pd_that_made_the_log_is_found(log: MotorLog):
    fit, reported = fitted(log, FRICTION)
    assert fit.converged and fit.error < 1e-3
    for name, value in TRUE.items():
        assert fit.constants[name] == pytest.approx(value, rel=0.05), name
    assert reported == fit.evaluations, "every simulation is reported"


def test_what_a_model_lacks_costs_error(log: MotorLog):
    errors = [fitted(log, free)[0].error for free in (GAINS, EVERYTHING, FRICTION)]
    assert errors[0] > 1.2 * errors[1] > 2.0 * errors[2]
