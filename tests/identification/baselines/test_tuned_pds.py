"""The tuned PD finds delay, rotor and limit of a PD that made a log, and follows the gains that logs state."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.bench_folder import training_motors
from motorprior.bench.dynamometer import run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.identification.baselines.pd_fit import TUNING, best_gains, tuned_pd
from motorprior.identification.baselines.replay_error import closed_loop_error, scaled_gains, trials, with_scaled_gains
from motorprior.identification.judging.log_fidelity import free_run_errors, whole_runs
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog

MOTORS = 2


@pytest.fixture(scope="module")
def bench() -> MotorLog:
    fleet = load_fleet("pupper_v2")
    return record(training_motors(fleet, MOTORS, 0), bench_preset("rollout"), 5000, 0, fleet)


def made_by(bench: MotorLog, kp: float, kd: float, limit: float, armature: float, delay: float) -> MotorLog:
    pd = IdealPd.uniform(MOTORS, kp, kd, limit, armature, delay)
    return replace(bench, joint_pos=np.concatenate([run(pd, trial).joint_pos for trial, _ in trials(bench)]))


@pytest.mark.parametrize("true", [(12.0, 0.6, 1.4, 0.018, 0.04), (8.0, 0.7, 1.2, 0.001, 0.008)])
def test_a_late_pd_with_a_heavy_rotor_and_a_limit_is_found(bench: MotorLog, true: tuple[float, ...]):
    log, counts = made_by(bench, *true), []
    found = tuned_pd(log, counts.append)
    assert closed_loop_error(log)(found) < 2e-3
    for name, value in zip(("kp", "kd", "torque_limit", "delay"), (*true[:3], true[4]), strict=True):
        assert getattr(found, name)[0] == pytest.approx(value, rel=0.15, abs=1e-3), name
    assert len(counts) <= TUNING


def test_the_best_gains_have_neither_rotor_nor_delay(bench: MotorLog):
    log = made_by(bench, 8.0, 0.7, 1.2, 0.0, 0.0)
    found = best_gains(log, IdealPd.uniform(MOTORS, 5.0, 0.3, 2.0))
    assert closed_loop_error(log)(found) < 1e-3 and not found.armature.any() and not found.delay.any()


def test_a_pd_has_the_gains_of_each_segment_in_proportion(bench: MotorLog):
    """It was fitted at a stated kp of 20; the judged log states 20 at first, then 40."""
    first = np.arange(bench.num_rows) < bench.segment_slices()[1].stop
    scale = np.where(first, 1.0, 2.0)[:, None] * np.ones(MOTORS)
    pd = IdealPd.uniform(MOTORS, 8.0, 0.5, 5.0)
    known = replace(bench, stated_kp=np.full_like(scale, 20.0), stated_kd=np.ones_like(scale))
    told = replace(bench, stated_kp=20.0 * scale, stated_kd=scale)
    tell = scaled_gains(known)
    made = [
        run(tell(pd, part), trial).joint_pos for (trial, _), part in zip(trials(told), told.segments(), strict=True)
    ]
    told = replace(told, joint_pos=np.concatenate(made), joint_vel=None)
    preset = replace(PRESETS["rollout"], gain_unit=told.gain_unit, warm_up=10)
    errors = free_run_errors(whole_runs(told, preset, ""), {"told": with_scaled_gains(pd, known), "blind": pd})
    assert np.all(errors["told"] < 0.2 * errors["blind"])
    assert with_scaled_gains(pd, bench) is pd, "of a log that states no gains"
