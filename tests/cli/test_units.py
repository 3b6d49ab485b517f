"""A constant is shown in its own unit, and a multiple of a stated gain as one."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.cli import adapt as command
from motorprior.logs.motor_log import GAIN_UNITS, PHYSICAL_GAINS, MotorLog
from motorprior.pipeline.adapt import OutlierTest, motor_constants

TERMS = ("profile", "dead_zone", "integral")


@pytest.fixture
def told(grey_network: Any) -> MotorPrior:
    """Motors with terms of a servo's firmware whose gains are one and a half and twice the stated ones."""
    network = replace(grey_network(terms=TERMS, kp=1.5, kd_over_kp=2.0), gain_unit=PHYSICAL_GAINS)
    gains, z = np.array([[10.0] * 3, [0.5] * 3]), np.zeros((3, 3))
    return MotorPrior(network, z, z, "rollout", "pupper_v2", "m", {}, {}, gains=gains)


def with_gains(prior: MotorPrior, unit: str) -> MotorPrior:
    return replace(prior, network=replace(prior.network, gain_unit=unit))


def log_of(unit: str) -> MotorLog:
    rows: Any = np.zeros((2, 3))
    return MotorLog(
        time=np.arange(2.0), position_target=rows, joint_pos=rows, joint_names=("a", "b", "c"), robot="r", motor="m",
        source="s", stated_kp=rows + 10.0, stated_kd=rows + 0.5, gain_unit=unit,
    )  # fmt: skip


def test_diff_shows_multiples_of_stated_gains_without_a_gains_unit_and_every_constant_of_the_terms(
    told: MotorPrior, tmp_path: Path, motorprior: Any
):
    paths = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    told.save(paths[0])
    assert told.network.motor is not None
    center = told.network.motor.center.copy()
    center[parameters_of(TERMS).index("integral_rate")] += np.log(2.0)
    replace(told, network=replace(told.network, motor=replace(told.network.motor, center=center))).save(paths[1])
    shown = motorprior("diff", *paths).out
    assert "kp [N·m/rad]" not in shown and "kd_over_kp [s]" not in shown
    rows = {line.split("│")[1].strip(): line for line in shown.splitlines() if line.count("│") > 3}
    assert {"kp_per_stated", "kd_over_kp_per_stated", "spread of kp_per_stated"} <= rows.keys()
    for name in ("profile_speed [rad/s]", "profile_acceleration [rad/s²]", "dead_zone [rad]", "integral_limit [N·m]"):
        assert name in rows and f"spread of {name}" in rows
    assert "+100.0 %" in rows["integral_rate [1/s]"]


@pytest.mark.parametrize("unit", GAIN_UNITS)
def test_adapt_names_si_units_only_where_the_gains_have_them(
    told: MotorPrior, capsys: pytest.CaptureFixture[str], unit: str
):
    log, prior = log_of(unit), with_gains(told, unit)
    constants = motor_constants(prior, log, prior.mean)
    found: Any = type("Found", (), {"loss": np.ones(3)})
    command._show(log, found, OutlierTest(np.ones(3), ("", "", "")), constants)
    shown = capsys.readouterr().out
    if unit == PHYSICAL_GAINS:
        assert constants["kp"] == pytest.approx(15.0) and constants["kd_over_kp"] == pytest.approx(0.1)
        assert "[SI units]" in shown and "per_stated" not in shown
    else:
        assert constants["kp_per_stated"] == pytest.approx(1.5) and "kp" not in constants
        assert "[SI units]" not in shown and "per unit of the firmware's gain" in shown
