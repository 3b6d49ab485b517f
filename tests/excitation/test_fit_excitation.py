"""Excitations learned from logs: their windows and classes, and the generator's training."""

from dataclasses import replace
from pathlib import Path
from typing import Any
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
    """A run of two legs.

    Knees swing four times as far as hips, and get an impact every half second.
    """
    time = 0.002 * np.arange(round(seconds / 0.002))
    rng = np.random.default_rng(seed)
    size = np.array([0.1, 0.4, 0.1, 0.4])
    phase = rng.uniform(0, 6, 4)
    target = 0.7 + size * np.sin(2 * np.pi * 1.5 * time[:, None] + phase)
    impact = np.where(time % 0.5 < 0.02, 1.0, 0.0)
    torque = impact[:, None] * (size > 0.2)
    load = {
        "external_torque": torque,
        "load_inertia": np.tile([2e-3, 1e-3, 2e-3, 1.5e-3], (len(time), 1)),
    }

    return log_of(time, target, **load, joint_names=NAMES, source=f"run {seed}")


def test_every_joint_without_a_class_is_a_class():
    names = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch")

    excitation = windows_of([replace(run_of(), joint_names=names)], 0.01)

    assert excitation.classes == names


def test_windows_have_the_amplitude_frequency_load_and_bounds_of_the_runs():
    excitation = windows_of([run_of(0), run_of(1)], 0.01, (0.2, 0.4))

    assert excitation.classes == ("hip", "knee")
    assert set(excitation.commands) == {0.2, 0.4}
    assert excitation.frequency == pytest.approx(1.5, rel=0.01)
    assert excitation.load_inertia.tolist() == [[2e-3, 2e-3], [1e-3, 1.5e-3]]

    # relative to the mean of the window, 0.7 rad
    knees = excitation.windows[excitation.window_class == 1]
    assert np.abs(knees[..., 0]).max() == pytest.approx(0.4, rel=0.02)

    # 1.25 times the largest torque of the class, which is 1 N·m for knees and 0 for hips
    hip, knee = excitation.bounds
    assert knee[3] == pytest.approx(1.25)
    assert hip[3] < 0.01


def test_a_run_without_motion_is_rejected():
    static = replace(run_of(), position_target=np.full((3000, 4), 0.7))

    with pytest.raises(LogError) as refusal:
        windows_of([static], 0.01)

    assert refusal.value.where == static.source


@pytest.mark.parametrize("frequency", [0.9, 1.3])
def test_a_larger_harmonic_does_not_change_the_gait_frequency(frequency: float):
    phase = 2 * np.pi * frequency * 0.01 * np.arange(250)
    target = 0.1 * np.sin(phase) + 0.3 * np.sin(2 * phase + 1.0)
    assert gait_frequency(target, 0.01) == pytest.approx(frequency, rel=0.01)


def test_runs_beyond_the_bounds_are_scaled_down():
    free = fit_excitation(run_of(), "recorded")
    limited = fit_excitation(run_of(), "recorded", max_speed=2.0)

    # hips are slower
    assert limited.bounds[1, 1] == 2.0
    assert limited.bounds[0].tolist() == free.bounds[0].tolist()

    limited_knees = limited.windows[limited.window_class == 1]
    free_knees = free.windows[free.window_class == 1]
    limited_targets = limited_knees[..., 0]
    correlation = np.corrcoef(limited_targets.ravel(), free_knees[..., 0].ravel())[0, 1]
    assert correlation > 1.0 - 1e-9
    assert np.abs(np.diff(limited_targets)).max() == pytest.approx(2.0 * limited.period)
    assert np.array_equal(limited_knees[..., 1:], free_knees[..., 1:])


WRONG = [
    ("commands", (0.1, 0.2)),  # of one run
    ("period", 0.05),
    ("max_speed", 0.0),
    ("max_torque", np.nan),
]


@pytest.mark.parametrize(("argument", "value"), WRONG)
def test_an_invalid_argument_is_named(argument: str, value: Any):
    with pytest.raises(ConfigError) as refusal:
        fit_excitation(run_of(), "recorded", **{argument: value})

    assert refusal.value.argument == argument


def test_an_artifact_of_another_kind_is_not_overwritten(tmp_path: Path):
    path = tmp_path / "prior.safetensors"
    write_tensors(path, {"a": np.zeros(1)}, {"kind": "motor prior"})

    with pytest.raises(ConfigError, match="motor prior"):
        fit_excitation(run_of(), "recorded", out=path)

    assert read_tensors(path)[1]["kind"] == "motor prior"


RUNS = (0, 1)
STEPS = 50


def trained(path: Path) -> Path:
    """The file of a generator after a training of STEPS on the runs with the seeds RUNS."""
    runs = [run_of(seed) for seed in RUNS]
    fit_excitation(runs, steps=STEPS, out=path, progress=SILENT)
    return path


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a training that was not interrupted."""
    return trained(tmp_path_factory.mktemp("excitations") / "whole.safetensors")


def test_an_interrupted_training_continues_and_ends_with_the_same_bytes(
    uninterrupted: Path, tmp_path: Path
):
    path = tmp_path / "resumed.safetensors"

    class Stop(Exception):
        pass

    with pytest.raises(Stop), mock.patch.object(Task, "advance", side_effect=Stop):
        trained(path)
    assert path.with_suffix(".checkpoint").exists()
    assert not path.exists()

    trained(path)

    assert path.read_bytes() == uninterrupted.read_bytes()


def test_a_finished_training_is_not_repeated(uninterrupted: Path):
    content = uninterrupted.read_bytes()

    with mock.patch.object(Task, "advance") as advance:
        trained(uninterrupted)

    advance.assert_not_called()
    assert uninterrupted.read_bytes() == content
    assert not uninterrupted.with_suffix(".checkpoint").exists()


def test_a_generator_learns_the_amplitudes_of_the_classes_and_names_its_runs(uninterrupted: Path):
    excitation = LearnedExcitation.load(uninterrupted)
    target, _ = excitation.frames(np.random.default_rng(0), 600, np.array([0, 1]))

    hip, knee = target.std(axis=0)
    assert knee > 1.5 * hip > 0.0
    sources = [run["source"] for run in excitation.provenance["trained_on"]]
    assert sources == ["run 0", "run 1"]
