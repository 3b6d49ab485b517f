"""Motors replay the log that they made; errors are pooled, capped, and warned about."""

from dataclasses import replace

import numpy as np
import pytest
from motor_logs import log_of, swinging_load

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import run, trial_of
from motorprior.bench.recording import bench_schedule, record
from motorprior.evaluation.errors import (
    MAX_ERROR,
    LogErrors,
    capped,
    notes_on_log,
    replay_errors,
)
from motorprior.evaluation.free_runs import (
    FREE_RUN,
    WHOLE_RUN,
    Validation,
    error_results,
    error_table,
    free_run_errors,
    free_runs,
    log_errors,
    median_and_max,
)
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.physics.window_runs import TorqueMotors
from motorprior.identification.presets import PRESETS, with_logged_settings
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT
from motorprior.signals import rms
from virtual_fleets.held_out_trials import bench_errors

MOTORS = 3
PRESET = replace(PRESETS["rollout"], warm_up=60, window=100)


@pytest.fixture(scope="module")
def log() -> MotorLog:
    fleet = load_fleet("mixed")
    return record(fleet.sample(MOTORS, 0), bench_schedule("rollout"), 5000, 0, fleet)


def pd(kp: float = 12.0) -> IdealPd:
    return IdealPd.uniform(MOTORS, kp, 0.1 * kp, 1.6)


def replayed(motors: TorqueMotors, log: MotorLog) -> np.ndarray:
    return rms(replay_errors(motors, log, {})[0], axis=0)


def test_a_whole_segment_is_one_free_run_and_errors_are_pooled(log: MotorLog):
    # a segment of 1000 rows, and one that is shorter than the warm-up
    log = log.rows(slice(0, 1030))
    runs = free_runs(log, PRESET)
    (whole,) = runs[WHOLE_RUN]

    assert whole.windows == 1
    assert whole.recipe.window == 1000 - 1 - 60
    assert runs[FREE_RUN][0].windows == 1
    assert runs[FREE_RUN][0].recipe.window == 500

    one = free_run_errors([whole], {"pd": pd()})["pd"]
    twice = free_run_errors([whole, whole], {"pd": pd()})["pd"]

    np.testing.assert_allclose(one, twice, rtol=1e-6)
    assert np.all(one > 1e-3)


def test_errors_are_capped_at_one_turn():
    errors = np.array([0.0, 0.3, MAX_ERROR, 7.0, 1e30, np.inf, np.nan])

    np.testing.assert_array_equal(capped(errors), [0.0, 0.3, *[MAX_ERROR] * 5])
    assert capped(np.array([[np.nan, 2.0]]), np.array([[1.0, 5.0]])).tolist() == [[1.0, 2.0]]


@pytest.fixture
def unstable() -> IdealPd:
    """Motors that push away from the target, without a torque limit."""
    return IdealPd.uniform(MOTORS, -50.0, 0.0, 1e9)


def test_a_diverged_simulation_is_named_in_the_table(log: MotorLog, unstable: IdealPd):
    run_errors = free_run_errors(free_runs(log, PRESET)[WHOLE_RUN], {"unstable": unstable})
    rows = error_results(
        LogErrors(("log",), log.joint_names, {"unstable": run_errors["unstable"][None]}), "e"
    )

    assert error_table(rows, {"e": "all"})[1] == [
        ["unstable", "diverged", "diverged", "diverged (motor_000)"]
    ]


def test_a_diverged_simulation_has_the_largest_error_on_a_bench(unstable: IdealPd):
    bench = bench_errors(
        load_fleet("mixed").sample(MOTORS, 4), {"unstable": lambda _: unstable}, 0
    )["impacts"]

    assert np.all(bench["unstable"] == MAX_ERROR)
    assert np.all(bench["physical"] < 0.1)


def test_motors_that_made_a_log_have_no_replay_error(log: MotorLog):
    motors = replayed(load_fleet("mixed").sample(MOTORS, 0).actuator(), log)
    assert np.median(motors) < 1e-9
    # dry friction amplifies rounding
    assert np.max(motors) < 2e-3


def test_a_tuned_pd_has_the_logged_gains_of_each_segment(log: MotorLog):
    # the gains are 6 times as large in the second half, which is a segment of its own
    is_second_half = np.arange(log.num_rows) >= log.num_rows // 2
    scale = np.where(is_second_half, 6.0, 1.0)[:, None] * np.ones(MOTORS)
    logged = replace(
        log,
        segment=is_second_half.astype(int),
        logged_kp=3.0 * scale,
        logged_kd=0.1 * scale,
    )

    positions = []
    for factor, segment in zip((1.0, 6.0), logged.segments(), strict=True):
        motors = IdealPd.uniform(MOTORS, 3.0 * factor, 0.1 * factor, 5.0, 0.001, 0.008)
        positions.append(run(motors, trial_of(segment)).joint_pos)
    logged = replace(logged, joint_pos=np.concatenate(positions), joint_vel=None)
    plain = replace(logged, logged_kp=None, logged_kd=None)

    scaled = replayed(fitted_tuned_pd(logged, SILENT), logged)
    fixed = replayed(fitted_tuned_pd(plain, SILENT), plain)

    assert np.median(scaled) < 0.3 * np.median(fixed)
    assert np.median(fixed) <= np.median(replayed(pd(), plain))


SEGMENTS = np.repeat([0, 1], 400)


def log_at(first_voltage: float, second_voltage: float) -> MotorLog:
    """Log of two segments with these supply voltages [V]."""
    supply_voltage = np.where(SEGMENTS == 0, first_voltage, second_voltage)[:, None]
    return swinging_load(800, segment=SEGMENTS, supply_voltage=supply_voltage)


RECIPE = with_logged_settings(PRESETS["long_runs"], log_at(12.0, 9.6))


@pytest.mark.parametrize(("terms", "effect"), [((), "not modelled"), (("supply",), "extrapolated")])
def test_a_voltage_outside_the_training_range_gives_a_warning(terms: tuple[str, ...], effect: str):
    (note,) = notes_on_log(log_at(24.0, 11.0), replace(RECIPE, terms=terms))

    assert note.severity == "warning"
    for text in ("supply_voltage", "11 to 24 V", "9.6 to 12 V", effect):
        assert text in note.text


def a_log(moving: list[bool]) -> MotorLog:
    """Log of a hip and a knee; those that are not ``moving`` keep their target."""
    target = np.where(moving, np.linspace(0.0, 1.0, 50)[:, None], 0.0)
    return log_of(0.01 * np.arange(50), target, joint_names=("hip", "knee"))


def test_errors_of_static_joints_do_not_count():
    logs = {"a": a_log([True, False]), "b": a_log([True, True])}
    errors = log_errors(
        logs, [{"prior": np.array([0.002, 9.0])}, {"prior": np.array([0.004, 0.009])}]
    )
    rows = error_results(errors, "e")

    assert rows.value(part=None, log=None) == pytest.approx(0.005)
    assert rows.value(part="knee") == pytest.approx(0.009)
    assert rows.value(log="a") == pytest.approx(0.002)
    assert median_and_max(errors.models["prior"]) == [(1, 0), (1, 1)]
    assert error_table(rows, {"e": "all"})[1] == [["prior", "6.0", "6.0", "9.0 (knee)"]]


def test_a_share_of_the_tuned_pds_error_is_unexplained():
    models = {"prior": np.array([[0.002, 0.004]]), "tuned_pd": np.array([[0.001, 0.01]])}
    errors = LogErrors(("log",), ("hip", "knee"), models)

    # relative to the tuned PD; 0.002 rad is the error of the encoder
    expected = [0.0, np.sqrt(0.004**2 - 0.002**2) / 0.01]
    np.testing.assert_allclose(errors.unexplained("prior"), expected)


@pytest.mark.parametrize(("pd_error", "count"), [(0.0098, 0), (0.008, 1)])
def test_a_simpler_model_is_preferred_if_it_is_clearly_better(pd_error: float, count: int):
    models = {"prior": np.array([[0.01]]), "tuned_pd": np.array([[pd_error]])}

    warnings = LogErrors(("log",), ("hip",), models).warnings("prior")

    assert len(warnings) == count
    assert all("8.00 instead of 10.00 mrad" in warning for warning in warnings)


def test_a_validation_prints_as_a_table():
    errors = LogErrors(("log",), ("hip", "knee"), {"prior": np.array([[0.002, 0.004]])})
    text = str(Validation(error_results(errors, "whole_run_rmse"), [], ["the model lacks physics"]))
    assert "warnings" in text
    assert "4.0 (knee)" in text
