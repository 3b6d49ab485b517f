"""Errors of models on logs, and warnings about motors and logs that a prior does not fit."""

from dataclasses import replace

import numpy as np
import pytest
from swinging_load import swinging_load

from motorprior.identification.evaluation.log_tables import error_table
from motorprior.identification.evaluation.model_errors import LogErrors, log_warnings
from motorprior.identification.presets import PRESETS, with_logged_settings
from motorprior.logs.motor_log import MotorLog

TWO = np.repeat([0, 1], 400)
KNOWN = swinging_load(800, segment=TWO, supply_voltage=np.where(TWO == 0, 12.0, 9.6)[:, None])
RECIPE = with_logged_settings(PRESETS["long_runs"], KNOWN)


def at(*volts: float) -> MotorLog:
    return swinging_load(800, segment=TWO, supply_voltage=np.repeat(volts, 800 // len(volts))[:, None])


@pytest.mark.parametrize("terms", [(), ("supply",)])
def test_voltages_between_those_of_the_training_logs_give_no_warning(terms: tuple[str, ...]):
    for volts in ((10.0,), (12.2,), (12.0, 9.6)):
        assert log_warnings(at(*volts), replace(RECIPE, terms=terms)) == []


@pytest.mark.parametrize(("terms", "effect"), [((), "not modelled"), (("supply",), "extrapolated")])
def test_a_voltage_outside_them_in_any_segment_gives_a_warning(terms: tuple[str, ...], effect: str):
    (line,) = log_warnings(at(24.0, 11.0), replace(RECIPE, terms=terms))
    assert "supply_voltage is 11 to 24 V, in the prior's logs 9.6 to 12 V" in line and effect in line


def test_the_usual_voltage_is_assumed_for_a_log_without_one():
    (line,) = log_warnings(swinging_load(800), replace(RECIPE, terms=("supply",)))
    assert "no supply_voltage: 10.8 V is assumed" in line
    assert log_warnings(swinging_load(800), RECIPE) == []


def a_log(moving: list[bool]) -> MotorLog:
    target = np.where(moving, np.linspace(0.0, 1.0, 50)[:, None], 0.0)
    return MotorLog(
        time=0.01 * np.arange(50), position_target=target, joint_pos=target, joint_names=("hip", "knee"), robot="r",
        motor="m", source="log",
    )  # fmt: skip


def test_joints_that_are_not_excited_do_not_count():
    logs = {"a": a_log([True, False]), "b": a_log([True, True])}
    found = {"a": {"prior": np.array([0.002, 9.0])}, "b": {"prior": np.array([0.004, 0.009])}}
    errors = LogErrors.of(logs, found)
    rows = errors.results("e")
    assert rows.value(part=None, log=None) == pytest.approx(0.005)
    assert rows.value(part="knee") == pytest.approx(0.009) and rows.value(log="a") == pytest.approx(0.002)
    assert errors.median_and_max("prior") == [(1, 0), (1, 1)]
    assert error_table(rows, {"e": "all"})[1] == [["prior", "6.0", "6.0", "9.0 (knee)"]]


def test_joints_with_more_than_a_third_of_the_tuned_pds_error_are_named():
    models = {"prior": np.array([[0.002, 0.004]]), "tuned_pd": np.array([[0.001, 0.01]])}
    errors = LogErrors(("log",), ("hip", "knee"), models)
    np.testing.assert_allclose(errors.unexplained("prior"), [0.0, np.sqrt(0.004**2 - 0.002**2) / 0.01])
    assert errors.warnings("prior") == []
    worse = LogErrors(("log",), ("hip", "knee"), models | {"prior": np.array([[0.002, 0.005]])})
    (line,) = worse.warnings("prior")
    assert "knee 46 %" in line and "hip" not in line
