"""A baseline that cannot be fitted is None; responses far from their command are fitted."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.identification.baselines.response_fit import (
    RESPONSE_CONSTANTS,
    ResponseMotors,
    at_bounds,
    fitted_responses,
)
from motorprior.identification.presets import identification_preset
from motorprior.identification.windows import with_window_that_fits
from motorprior.priors.validate import baseline_recipes, fitted_baselines
from motorprior.progress import SILENT, Lines


def test_a_prior_of_long_runs_has_servo_baselines_whatever_the_length_of_its_log():
    time = 0.002 * np.arange(400)
    target = 0.3 * np.sin(9.0 * time)[:, None]
    log = log_of(time, target, target)
    preset = identification_preset("long_runs")
    recipe = with_window_that_fits(preset, log)

    assert recipe.window < preset.window
    assert {"coulomb_viscous", "stribeck"} <= baseline_recipes(log, recipe).keys()


def test_a_baseline_that_fails_is_none_with_a_warning(tmp_path: Path):
    time = 0.002 * np.arange(400)
    target = 0.3 * np.sin(9.0 * time)[:, None]
    load = {"load_inertia": np.full_like(target, 0.01), "external_torque": 0.0 * target}
    log = log_of(time, target, np.roll(target, 5, axis=0), **load)

    for name in ("per_motor", "pooled_network"):
        (tmp_path / name).write_text("a file where the fit's folder should be")

    output = StringIO()
    baselines = fitted_baselines(
        log, identification_preset("rollout"), tmp_path, progress=Lines(output)
    )
    failed = [name for name, motors in baselines.items() if motors is None]

    assert failed == ["per_motor", "pooled_network"]
    assert baselines["tuned_pd"] is not None
    for name in failed:
        assert f"baseline {name}" in output.getvalue()
        assert str(tmp_path / name) in output.getvalue()


def test_a_fit_recovers_the_response_of_a_joint_far_from_its_command():
    time = 0.002 * np.arange(2000)
    command = 0.2 * np.sin(2 * np.pi * 0.7 * time) + 0.1 * np.sin(2 * np.pi * 1.7 * time)
    angle = 1.2 * np.roll(command, 65) + 0.68
    log = log_of(time, command, angle).rows(slice(100, None))
    motors = fitted_responses(log, identification_preset("rollout"), 0, SILENT)["servo_limits"]
    constants = dict(zip(RESPONSE_CONSTANTS, motors.constants[0].tolist(), strict=True))

    # Slow sines do not distinguish a delay from the lag of a second-order system. The sum is 65
    # rows of 2 ms.
    lag = 2.0 * constants["damping"] / constants["rate"]
    assert constants["delay"] + lag == pytest.approx(0.13, abs=0.01)
    assert constants["gain"] == pytest.approx(1.2, abs=0.03)
    assert constants["offset"] == pytest.approx(0.68, abs=0.02)


def test_constants_at_the_bounds_of_the_search_are_marked():
    values = RESPONSE_CONSTANTS | {"delay": 1e-4, "rate": 600.0, "band": 0.1, "gain": 1.2}
    reached = at_bounds(ResponseMotors(np.array([list(values.values())])))
    assert [name for name, mask in reached.items() if mask.any()] == ["delay", "rate"]
