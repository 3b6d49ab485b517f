"""The PD that made a log is recovered, and scales with the gains of other logs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.bench.dynamometer import run, trial_of
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import bench_preset, record, training_motors
from motorprior.identification.baselines.pd_fit import WITH_FRICTION, WITH_ROTOR, fit_pd, with_scaled_gains
from motorprior.identification.evaluation.free_runs import free_run_errors
from motorprior.identification.physics.window_runs import whole_runs
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog

MOTORS = 2
WITH_ALL = {"kp": 7.0, "kd": 0.7, "torque_limit": 1.2, "armature": 0.004, "delay": 0.004, "coulomb": 0.15}
SLOW = {"kp": 12.0, "kd": 0.6, "torque_limit": 1.4, "armature": 0.018, "delay": 0.04}


@pytest.fixture(scope="module")
def bench() -> MotorLog:
    fleet = load_fleet("pupper_v2")
    return record(training_motors(fleet, MOTORS, 0), bench_preset("rollout"), 5000, 0, fleet)


def made_by(bench: MotorLog, motors: Actuator, at: Sequence[Actuator] | None = None) -> MotorLog:
    """The same commands and loads with the motion of these motors, or of other ones in every segment."""
    parts = list(bench.segments())
    cases = zip(at or [motors] * len(parts), parts, strict=True)
    return replace(bench, joint_pos=np.concatenate([run(one, trial_of(part)).joint_pos for one, part in cases]))


@pytest.mark.parametrize(("true", "free"), [(WITH_ALL, WITH_FRICTION), (SLOW, WITH_ROTOR)], ids=["friction", "slow"])
def test_the_pd_that_made_a_log_is_found(bench: MotorLog, true: dict[str, float], free: tuple[str, ...]):
    fit = fit_pd(made_by(bench, IdealPd.uniform(MOTORS, **true)), free)
    assert fit.error < 2e-3
    for name in set(true) - {"armature"}:
        assert fit.constants[name] == pytest.approx(true[name], rel=0.1, abs=1e-3), name


def test_a_pd_is_scaled_to_the_gains_of_each_segment(bench: MotorLog):
    first = np.arange(bench.num_rows) < bench.segment_slices()[1].stop
    scale = np.where(first, 1.0, 2.0)[:, None] * np.ones(MOTORS)
    pd = IdealPd.uniform(MOTORS, 8.0, 0.5, 5.0)
    fitted = replace(bench, stated_kp=np.full_like(scale, 20.0), stated_kd=np.ones_like(scale))
    other = replace(bench, stated_kp=20.0 * scale, stated_kd=scale)
    model = with_scaled_gains(pd, fitted)
    assert isinstance(model, GainScaledPd)
    other = replace(
        made_by(other, pd, [model.at(part.gains) for part in other.segments() if part.gains is not None]),
        joint_vel=None,
    )
    preset = replace(PRESETS["rollout"], warm_up=10)
    errors = free_run_errors(whole_runs(other, preset), {"scaled": with_scaled_gains(pd, fitted), "fixed": pd})
    assert np.all(errors["scaled"] < 0.2 * errors["fixed"])
    assert with_scaled_gains(pd, bench) is pd
