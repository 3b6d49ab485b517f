"""Streams of learned excitations: their bounds, seams, reproducibility and file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.excitation.bounded_stream import Bounds, bounded
from motorprior.excitation.frames import CHANNELS, TORQUES_PER_FRAME
from motorprior.excitation.generator import CODE_SIZE, weight_shapes
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.excitation.recorded import FADE, recorded_stream
from motorprior.excitation.registry import EXCITATIONS, excitation_of
from motorprior.excitation.run_windows import MIN_SCALE
from motorprior.excitation.surrogate import surrogate_stream

DT = 0.01


def made_excitation(method: str = "recorded") -> LearnedExcitation:
    """An excitation of two classes: sines of two amplitudes with random torques, random weights."""
    rng = np.random.default_rng(3)
    which = np.repeat([0, 1], 10)
    time = DT * np.arange(64)
    size = np.array([0.1, 0.4])[which][:, None]
    frequency = rng.uniform(1.0, 3.0, 20)
    target = size * np.sin(2 * np.pi * (frequency[:, None] * time + rng.random((20, 1))))
    torque = 0.3 * rng.standard_normal((20, 64, TORQUES_PER_FRAME))
    windows = np.concatenate([target[..., None], torque], axis=2)
    limits = np.array([[0.15, 3.0, 100.0, 1.0], [0.5, 12.0, 400.0, 1.5]])
    scales = np.stack([windows[which == index].std(axis=(0, 1)) for index in (0, 1)])

    weights = {}
    for name, shape in {"codes": (20, CODE_SIZE), **weight_shapes(2)}.items():
        if len(shape) > 1:
            weights[name] = rng.standard_normal(shape) / np.sqrt(np.prod(shape[:-1]))
        else:
            weights[name] = np.zeros(shape)

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
def test_a_bounded_stream_keeps_its_bounds_whatever_the_signal(
    size, amplitude, speed, acceleration, seed
):
    raw = size * np.cumsum(np.random.default_rng(seed).standard_normal((200, 3)), axis=0)
    stream = bounded(raw, Bounds(amplitude, speed, acceleration, 1.0), DT)

    assert np.abs(stream).max() <= amplitude * (1 + 1e-9)
    assert np.abs(np.diff(stream, axis=0)).max() <= speed * DT * (1 + 1e-9)
    assert np.abs(np.diff(stream, n=2, axis=0)).max() <= acceleration * DT**2 * (1 + 1e-6)


def test_a_signal_well_inside_the_bounds_is_kept():
    raw = 0.2 * np.sin(2 * np.pi * 2.0 * DT * np.arange(301))[:, None]  # 2.5 rad/s, 32 rad/s²
    stream = bounded(raw, Bounds(0.5, 12.0, 400.0, 1.0), DT)
    assert np.abs(stream - raw[1:])[100:].max() < 0.002


@pytest.mark.parametrize("method", ["recorded", "surrogate", "generated"])
def test_streams_of_any_length_keep_the_bounds_and_have_no_seams(method: str):
    excitation = made_excitation(method)
    frames = 500  # eight windows
    which = np.array([0, 1, 1])
    target, torque = excitation.frames(np.random.default_rng(1), frames, which)
    again, _ = excitation.frames(np.random.default_rng(1), frames, which)
    limits = excitation.bounds[which]

    assert target.shape == (frames, 3)
    assert torque.shape == (frames * TORQUES_PER_FRAME, 3)
    assert target.tobytes() == again.tobytes()
    assert np.all(np.abs(target) <= limits[:, 0])
    assert np.all(np.abs(np.diff(target, axis=0)) <= limits[:, 1] * DT * (1 + 1e-9))
    assert np.all(np.abs(np.diff(target, n=2, axis=0)) <= limits[:, 2] * DT**2 * (1 + 1e-6))
    assert np.all(np.abs(torque) <= limits[:, 3])
    assert target[:, 1].std() > 2.0 * target[:, 0].std() > 0.0  # a knee moves more than the hip
    assert not np.array_equal(target[:, 1], target[:, 2])


def test_a_channel_that_is_constant_in_the_runs_stays_constant():
    runs = made_excitation("generated")
    scales = np.column_stack([runs.scales[:, :1], np.full((2, TORQUES_PER_FRAME), MIN_SCALE)])
    excitation = replace(runs, scales=scales)

    target, torque = excitation.frames(np.random.default_rng(1), 50, np.array([0, 1]))

    assert target.std() > 0.0
    assert np.abs(torque).max() < 100 * MIN_SCALE


def test_recorded_windows_are_all_played_and_seams_fade():
    runs = made_excitation()
    knees = runs.windows[runs.window_class == 1]
    raw = recorded_stream(knees, np.random.default_rng(0), 10 * (64 - FADE))

    # the window that the middle of each part, without its fades, came from
    played = set()
    for middle in raw.reshape(10, 64 - FADE, CHANNELS)[:, FADE:]:
        differences = np.abs(runs.windows[:, FADE:-FADE] - middle).max(axis=(1, 2))
        played.add(int(np.argmin(differences)))
    assert played == set(range(10, 20))

    # amplitude 0.4 rad at up to 3 Hz, and a fade over at most 0.8 rad
    max_step = 0.4 * 2 * np.pi * 3.0 * DT
    max_fade = 0.8 * np.pi / 2 / FADE
    assert np.abs(np.diff(raw[:, 0])).max() < max_step + max_fade


def test_surrogates_have_the_marginals_and_the_frequency_of_the_runs():
    runs = made_excitation()
    knees = runs.windows[runs.window_class == 1]
    raw = surrogate_stream(knees, np.random.default_rng(0), 4096)
    knees = knees.reshape(-1, CHANNELS)

    levels = np.linspace(0.05, 0.95, 19)
    quantiles = np.quantile(raw, levels, axis=0)
    assert quantiles == pytest.approx(np.quantile(knees, levels, axis=0), abs=0.02)

    power = np.abs(np.fft.rfft(raw[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(raw), DT)
    in_band = (frequency > 0.3) & (frequency < 4.0)
    assert power[in_band].sum() > 0.8 * power[1:].sum()


def test_targets_are_held_and_torques_averaged_at_other_periods():
    excitation = made_excitation()
    fine = excitation.streams(np.random.default_rng(2), 1000, 0.002, ["FR_knee"])
    coarse = excitation.streams(np.random.default_rng(2), 200, DT, ["FR_knee"])

    assert np.array_equal(fine.position_target[::5], coarse.position_target)
    assert np.all(np.diff(fine.position_target.reshape(200, 5), axis=1) == 0.0)
    mean_torque = fine.external_torque.reshape(200, 5).mean(axis=1)
    assert mean_torque == pytest.approx(coarse.external_torque[:, 0])

    # within the range of the knees
    assert fine.load_inertia is not None
    assert 1e-4 <= fine.load_inertia[0] <= 2e-4


def test_a_joint_plays_the_class_of_its_position_whatever_its_side_and_suffix():
    """Loads tell the classes apart: 1e-3 to 2e-3 kg·m² at hips, 1e-4 to 2e-4 at calves."""
    excitation = replace(made_excitation(), classes=("hip", "calf"))
    legs = ("FL", "FR", "RL", "RR")
    names = [f"{leg}_{part}_joint" for leg in legs for part in ("hip", "calf")]

    for seed in range(3):
        inertia = excitation.streams(np.random.default_rng(seed), 10, DT, names).load_inertia

        assert inertia is not None
        assert np.all(inertia[::2] >= 1e-3)
        assert np.all(inertia[1::2] <= 2e-4)


def test_a_period_longer_than_that_of_the_runs_is_rejected():
    with pytest.raises(ConfigError) as refusal:
        made_excitation().streams(np.random.default_rng(2), 10, 0.02, ["FR_knee"])

    assert refusal.value.argument == "period"
    assert "0.02 s" in str(refusal.value)


def test_a_loaded_excitation_gives_the_streams_of_the_saved_one(tmp_path: Path):
    path = tmp_path / "walk.safetensors"
    excitation = made_excitation("generated")
    excitation.save(path)
    loaded = excitation_of(str(path))

    joint_names = ["l_hip", "b"]
    saved_stream = excitation.streams(np.random.default_rng(4), 60, DT, joint_names)
    loaded_stream = loaded.streams(np.random.default_rng(4), 60, DT, joint_names)

    assert loaded_stream.position_target.tobytes() == saved_stream.position_target.tobytes()


def test_a_name_gives_its_excitation_and_an_unknown_one_is_an_error():
    assert excitation_of("sine") is EXCITATIONS["sine"]
    with pytest.raises(ConfigError, match="waltz"):
        excitation_of("waltz")


def test_a_file_with_tensors_of_a_wrong_shape_is_rejected(tmp_path: Path):
    path = tmp_path / "walk.safetensors"
    replace(made_excitation(), weights={}, scales=np.ones((2, CHANNELS - 1))).save(path)

    with pytest.raises(ArtifactError, match="scales"):
        LearnedExcitation.load(path)
