"""Excitations learned from logs: windows and classes, and the generator's training."""

from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ConfigError, LogError
from motorprior.excitation.fit_excitation import fit_excitation
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.excitation.run_windows import gait_frequency, windows_of
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT, Task

NAMES = ("L_hip", "L_knee", "R_hip", "R_knee")


def run_of(seed: int = 0, seconds: float = 6.0) -> MotorLog:
    """A run of two legs: knees swing four times as far as hips, and carry an impact every half second."""
    time = 0.002 * np.arange(round(seconds / 0.002))
    rng = np.random.default_rng(seed)
    size = np.array([0.1, 0.4, 0.1, 0.4])
    phase = rng.uniform(0, 6, 4)
    target = 0.7 + size * np.sin(2 * np.pi * 1.5 * time[:, None] + phase)
    torque = np.where((time % 0.5 < 0.02)[:, None], 1.0, 0.0) * (size > 0.2)
    load = {
        "external_torque": torque,
        "load_inertia": np.tile([2e-3, 1e-3, 2e-3, 1.5e-3], (len(time), 1)),
    }
    return log_of(time, target, **load, joint_names=NAMES, source=f"run {seed}")


def test_joints_without_classes_have_windows_of_their_own():
    names = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch")
    assert windows_of([replace(run_of(), joint_names=names)], 0.01).classes == names


def test_windows_are_relative_to_the_mean_and_know_frequency_load_and_bounds():
    found = windows_of([run_of(0), run_of(1)], 0.01, (0.2, 0.4))
    assert found.classes == ("hip", "knee") and set(found.commands) == {0.2, 0.4}
    knees = found.windows[found.window_class == 1]
    assert np.abs(knees[..., 0]).max() == pytest.approx(0.4, rel=0.02)
    assert found.frequency == pytest.approx(1.5, rel=0.01)
    assert found.load_inertia.tolist() == [[2e-3, 2e-3], [1e-3, 1.5e-3]]
    # hips carry nothing
    assert found.bounds[1, 3] == pytest.approx(1.25) and found.bounds[0, 3] < 0.01
    still = replace(run_of(), position_target=np.full((3000, 4), 0.7))
    with pytest.raises(LogError, match="moving joint"):
        windows_of([still], 0.01)


@pytest.mark.parametrize("frequency", [0.9, 1.3])
def test_the_gait_frequency_is_that_of_the_cycle_even_if_a_harmonic_is_larger(frequency: float):
    phase = 2 * np.pi * frequency * 0.01 * np.arange(250)
    target = 0.1 * np.sin(phase) + 0.3 * np.sin(2 * phase + 1.0)
    assert gait_frequency(target, 0.01) == pytest.approx(frequency, rel=0.01)


def test_runs_beyond_the_given_bounds_are_scaled_down():
    free = fit_excitation(run_of(), "recorded")
    found = fit_excitation(run_of(), "recorded", max_speed=2.0)
    # hips are slower
    assert found.bounds[1, 1] == 2.0 and found.bounds[0].tolist() == free.bounds[0].tolist()
    knees, own = (each.windows[each.window_class == 1] for each in (found, free))
    assert np.corrcoef(knees[..., 0].ravel(), own[..., 0].ravel())[0, 1] > 1.0 - 1e-9
    assert np.abs(np.diff(knees[..., 0])).max() == pytest.approx(2.0 * found.period)
    assert np.array_equal(knees[..., 1:], own[..., 1:])


WRONG = [{"commands": (0.1, 0.2)}, {"period": 0.05}, {"max_speed": 0.0}, {"max_torque": np.nan}]


@pytest.mark.parametrize("given", WRONG, ids=lambda given: next(iter(given)))
def test_wrong_arguments_are_refused(given):
    with pytest.raises(ConfigError, match=next(iter(given))):
        fit_excitation(run_of(), "recorded", **given)


def test_an_artifact_of_another_kind_is_not_overwritten(tmp_path: Path):
    path = tmp_path / "prior.safetensors"
    write_tensors(path, {"a": np.zeros(1)}, {"kind": "motor prior"})
    with pytest.raises(ConfigError, match="motor prior"):
        fit_excitation(run_of(), "recorded", out=path)
    assert read_tensors(path)[1]["kind"] == "motor prior"


def test_training_repeats_its_bytes_continues_where_it_stopped_and_learns_the_sizes(tmp_path: Path):
    runs = [run_of(0), run_of(1)]
    whole = tmp_path / "whole.safetensors"
    parts = tmp_path / "parts.safetensors"
    fit_excitation(runs, steps=50, out=whole, progress=SILENT)

    class Stop(Exception):
        pass

    with pytest.raises(Stop), mock.patch.object(Task, "advance", side_effect=Stop):
        fit_excitation(runs, steps=50, out=parts, progress=SILENT)
    assert parts.with_suffix(".checkpoint").exists() and not parts.exists()
    fit_excitation(runs, steps=50, out=parts, progress=SILENT)
    assert whole.read_bytes() == parts.read_bytes()
    with mock.patch.object(Task, "advance") as advance:
        fit_excitation(runs, steps=50, out=whole, progress=SILENT)
    advance.assert_not_called()
    assert (
        whole.read_bytes() == parts.read_bytes() and not whole.with_suffix(".checkpoint").exists()
    )
    found = LearnedExcitation.load(whole)
    assert [run["source"] for run in found.provenance["trained_on"]] == ["run 0", "run 1"]
    target, _ = found.frames(np.random.default_rng(0), 600, np.array([0, 1]))
    assert target[:, 1].std() > 1.5 * target[:, 0].std() > 0.0
