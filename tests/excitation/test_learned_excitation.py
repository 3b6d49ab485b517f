"""Streams from runs: bounds that nothing breaks, no seams, same bytes, and the file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.excitation.bounded_stream import Bounds, bounded
from motorprior.excitation.frames import CHANNELS, SUB
from motorprior.excitation.generator import CODE, weight_shapes
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.excitation.recorded import FADE, recorded_stream
from motorprior.excitation.registry import EXCITATIONS, excitation_of
from motorprior.excitation.run_windows import MIN_SCALE
from motorprior.excitation.surrogate import surrogate_stream

DT = 0.01


def sample(method: str = "recorded") -> LearnedExcitation:
    """Two classes: sines with impacts, of different size; a generator of random weights."""
    rng = np.random.default_rng(3)
    which = np.repeat([0, 1], 10)
    time = DT * np.arange(64)
    size = np.array([0.1, 0.4])[which][:, None]
    frequency = rng.uniform(1.0, 3.0, 20)
    target = size * np.sin(2 * np.pi * (frequency[:, None] * time + rng.random((20, 1))))
    torque = 0.3 * rng.standard_normal((20, 64, SUB))
    windows = np.concatenate([target[..., None], torque], axis=2)
    limits = np.array([[0.15, 3.0, 100.0, 1.0], [0.5, 12.0, 400.0, 1.5]])
    shapes = {"codes": (20, CODE), **weight_shapes(2)}.items()
    weights = {
        n: rng.standard_normal(s) / np.sqrt(np.prod(s[:-1])) if len(s) > 1 else np.zeros(s)
        for n, s in shapes
    }
    scales = np.stack([windows[which == kind].std(axis=(0, 1)) for kind in (0, 1)])
    return LearnedExcitation(
        method,
        ("hip", "knee"),
        DT,
        windows,
        which,
        np.zeros(20),
        frequency,
        scales,
        limits,
        np.array([[1e-3, 2e-3], [1e-4, 2e-4]]),
        weights,
        {"trained_on": [{"source": "made up"}]},
    )


@settings(max_examples=30, deadline=None)
@given(
    size=st.floats(1e-3, 1e3),
    amplitude=st.floats(1e-2, 2.0),
    speed=st.floats(0.1, 50.0),
    acceleration=st.floats(1.0, 5e3),
    seed=st.integers(0, 99),
)
def test_no_raw_signal_breaks_the_bounds(size, amplitude, speed, acceleration, seed):
    raw = size * np.cumsum(np.random.default_rng(seed).standard_normal((200, 3)), axis=0)
    found = bounded(raw, Bounds(amplitude, speed, acceleration, 1.0), DT)
    assert np.abs(found).max() <= amplitude * (1 + 1e-9)
    assert np.abs(np.diff(found, axis=0)).max() <= speed * DT * (1 + 1e-9)
    assert np.abs(np.diff(found, n=2, axis=0)).max() <= acceleration * DT**2 * (1 + 1e-6)


def test_a_signal_well_inside_the_bounds_is_kept():
    raw = 0.2 * np.sin(2 * np.pi * 2.0 * DT * np.arange(301))[:, None]  # 2.5 rad/s, 32 rad/s²
    found = bounded(raw, Bounds(0.5, 12.0, 400.0, 1.0), DT)
    assert np.abs(found - raw[1:])[100:].max() < 0.002


@pytest.mark.parametrize("method", ["recorded", "surrogate", "generated"])
def test_streams_of_any_length_keep_the_bounds_and_have_no_seams(method: str):
    excitation = sample(method)
    # eight windows long
    frames = 500
    which = np.array([0, 1, 1])
    target, torque = excitation.frames(np.random.default_rng(1), frames, which)
    again, _ = excitation.frames(np.random.default_rng(1), frames, which)
    limits = excitation.bounds[which]
    assert target.shape == (frames, 3) and torque.shape == (frames * SUB, 3)
    assert target.tobytes() == again.tobytes()
    assert np.all(np.abs(target) <= limits[:, 0])
    assert np.all(np.abs(np.diff(target, axis=0)) <= limits[:, 1] * DT * (1 + 1e-9))
    assert np.all(np.abs(np.diff(target, n=2, axis=0)) <= limits[:, 2] * DT**2 * (1 + 1e-6))
    assert np.all(np.abs(torque) <= limits[:, 3])
    assert target[:, 1].std() > 2.0 * target[:, 0].std() > 0.0  # a knee moves more than the hip
    assert not np.array_equal(target[:, 1], target[:, 2])


def test_a_channel_that_is_constant_in_the_runs_stays_constant():
    runs = sample("generated")
    scales = np.column_stack([runs.scales[:, :1], np.full((2, SUB), MIN_SCALE)])
    target, torque = replace(runs, scales=scales).frames(
        np.random.default_rng(1), 50, np.array([0, 1])
    )
    assert target.std() > 0.0 and np.abs(torque).max() < 100 * MIN_SCALE


def test_recorded_windows_are_all_played_and_seams_fade():
    runs = sample()
    knees = runs.windows[runs.window_class == 1]
    raw = recorded_stream(knees, np.random.default_rng(0), 10 * (64 - FADE))
    middles = raw.reshape(10, 64 - FADE, CHANNELS)[:, FADE:]
    played = {
        int(np.argmin([np.abs(own[FADE:-FADE] - middle).max() for own in runs.windows]))
        for middle in middles
    }
    assert played == set(range(10, 20))
    steps = np.abs(np.diff(raw[:, 0])).max()
    # own speed, and a fade over at most 0.8 rad
    assert steps < 0.4 * 2 * np.pi * 3.0 * DT + 0.8 * np.pi / 2 / FADE


def test_surrogates_have_the_marginals_and_the_frequency_of_the_runs():
    runs = sample()
    knees = runs.windows[runs.window_class == 1]
    raw = surrogate_stream(knees, np.random.default_rng(0), 4096)
    knees = knees.reshape(-1, CHANNELS)
    shares = np.linspace(0.05, 0.95, 19)
    assert np.quantile(raw, shares, axis=0) == pytest.approx(
        np.quantile(knees, shares, axis=0), abs=0.02
    )
    power = np.abs(np.fft.rfft(raw[:, 0])) ** 2
    at = np.fft.rfftfreq(len(raw), DT)
    assert power[(at > 0.3) & (at < 4.0)].sum() > 0.8 * power[1:].sum()


def test_targets_are_held_and_torques_averaged_at_other_periods():
    excitation = sample()
    fine = excitation.streams(np.random.default_rng(2), 1000, 0.002, ["FR_knee"])
    coarse = excitation.streams(np.random.default_rng(2), 200, DT, ["FR_knee"])
    assert np.array_equal(fine.position_target[::5], coarse.position_target)
    assert np.all(np.diff(fine.position_target.reshape(200, 5), axis=1) == 0.0)
    assert fine.external_torque.reshape(200, 5).mean(axis=1) == pytest.approx(
        coarse.external_torque[:, 0]
    )
    assert fine.load_inertia is not None and 1e-4 <= fine.load_inertia[0] <= 2e-4  # of the knees
    with pytest.raises(ConfigError, match=r"0\.02 s"):
        excitation.streams(np.random.default_rng(2), 10, 0.02, ["FR_knee"])


def test_a_file_gives_the_same_streams_and_one_look_up_finds_it(tmp_path: Path):
    path = tmp_path / "walk.safetensors"
    sample("generated").save(path)
    found = excitation_of(str(path))
    streams = [
        each.streams(np.random.default_rng(4), 60, DT, ["a_hip", "b"])
        for each in (sample("generated"), found)
    ]
    assert streams[0].position_target.tobytes() == streams[1].position_target.tobytes()
    assert excitation_of("sine") is EXCITATIONS["sine"]
    with pytest.raises(ConfigError, match="waltz"):
        excitation_of("waltz")


def test_files_that_do_not_fit_are_rejected(tmp_path: Path):
    path = tmp_path / "walk.safetensors"
    replace(sample(), weights={}, scales=np.ones((2, CHANNELS - 1))).save(path)
    with pytest.raises(ArtifactError, match="scales"):
        LearnedExcitation.load(path)
    with pytest.raises(ConfigError, match="generator"):
        replace(sample(), weights={}).with_method("generated")
