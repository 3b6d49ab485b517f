"""Likeness of an excitation to the runs of a robot: a two-sample test on windows, and coverage."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.bench.recording import BENCH_SCHEDULES
from motorprior.excitation.excitation import Excitation
from motorprior.excitation.frames import TORQUES_PER_FRAME
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.excitation.registry import EXCITATIONS
from motorprior.results import Result, Results
from virtual_fleets.two_sample import standardise, two_sample_auc

BANDS = (0.0, 2.0, 5.0, 10.0, 50.0)  # of the target's spectrum [Hz]
FEATURES = (
    "target_std", "speed_rms", "speed_max", "acceleration_rms", "acceleration_max",
    *(f"power_{low:g}_{high:g}_hz" for low, high in pairwise(BANDS)),
    "torque_rms", "torque_max", "torque_rate_rms", "impacts", "reversals",
)  # fmt: skip
LINEAR = ("impacts", "reversals")  # features [1/s]; of the others the logarithm is taken
IMPACT = 4.0  # torque rate of an impact over the root mean square of the runs'
NEIGHBOURS = 5  # of `coverage`
COUNT = 200  # windows of each kind and class
STREAMS = 8  # from which windows are cut
SHIFTS = 16  # frames by which a window may be shifted, either way, against one that it copies
# share of windows that are nearest to the training windows: a copy with a seam is not near
CLOSE = 0.1
RUNS = "runs"  # windows of the test runs
TRAIN = "train"  # the training windows themselves: what an excitation can reach at best
KINDS = ("sinusoid", "rollout", "surrogate", "recorded", "generated")


def features(windows: np.ndarray, period: float, impact_rate: float) -> np.ndarray:
    """(W, features) of windows (W, frames, CHANNELS) with frames of ``period`` [s]; see FEATURES.

    An impact is a rise of |d torque/dt| above ``impact_rate`` [N·m/s], a reversal a change of the
    sign of the speed.
    """
    target = windows[..., 0]
    torque = windows[..., 1:].reshape(len(windows), -1)
    speed = np.diff(target, axis=1) / period
    acceleration = np.diff(speed, axis=1) / period
    torque_rate = np.diff(torque, axis=1) * TORQUES_PER_FRAME / period
    sizes = [
        target.std(axis=1),
        _rms(speed),
        np.abs(speed).max(axis=1),
        _rms(acceleration),
        np.abs(acceleration).max(axis=1),
        *_band_powers(target, period),
        _rms(torque),
        np.abs(torque).max(axis=1),
        _rms(torque_rate),
    ]
    logarithms = [np.log(np.maximum(size, 1e-6)) for size in sizes]

    seconds = period * target.shape[1]
    is_impact = np.abs(torque_rate) > impact_rate
    impacts = (~is_impact[:, :-1] & is_impact[:, 1:]).sum(axis=1) / seconds
    reversals = _reversals(speed) / seconds
    return np.stack([*logarithms, impacts, reversals], axis=1)


def _rms(signal: np.ndarray) -> np.ndarray:
    """(W,) root mean square of signals (W, samples)."""
    return np.sqrt(np.mean(signal**2, axis=1))


def _band_powers(target: np.ndarray, period: float) -> list[np.ndarray]:
    """(W,) power of the target in each of BANDS."""
    centred = target - target.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred * np.hanning(target.shape[1]))) ** 2
    frequency = np.fft.rfftfreq(target.shape[1], period)
    return [
        power[:, (frequency >= low) & (frequency < high)].sum(axis=1)
        for low, high in pairwise(BANDS)
    ]


def _reversals(speed: np.ndarray) -> np.ndarray:
    """(W,) number of changes of the sign of speeds (W, samples), without low speeds."""
    is_fast = np.abs(speed) > 0.05 * np.abs(speed).max(axis=1, keepdims=True)
    signs = np.where(is_fast, np.sign(speed), 0.0)
    return np.array([np.count_nonzero(np.diff(row[row != 0.0])) for row in signs])


def windows_of_kind(
    runs: LearnedExcitation, kind: str, joint_class: str, rng: np.random.Generator
) -> np.ndarray:
    """(COUNT, frames, CHANNELS) windows of an excitation of ``KINDS`` for one class."""
    sources = _sources(runs, kind)
    num_frames = runs.windows.shape[1]
    num_windows = -(-COUNT // (STREAMS * len(sources)))  # of a stream
    frames_of_stream = num_windows * num_frames
    windows = []
    for source in sources:
        streams = source.streams(
            rng,
            frames_of_stream * TORQUES_PER_FRAME,
            runs.period / TORQUES_PER_FRAME,
            [joint_class] * STREAMS,
        )
        shape = (STREAMS, frames_of_stream, TORQUES_PER_FRAME)
        target = streams.position_target.T.reshape(shape).mean(axis=2, keepdims=True)
        target = target - target.mean(axis=1, keepdims=True)
        torque = streams.external_torque.T.reshape(shape)
        frames = np.concatenate([target, torque], axis=2)
        windows.append(frames.reshape(STREAMS * num_windows, num_frames, 1 + TORQUES_PER_FRAME))
    return rng.permutation(np.concatenate(windows))[:COUNT]


def _sources(runs: LearnedExcitation, kind: str) -> Sequence[Excitation | LearnedExcitation]:
    """The excitations that a kind is made of."""
    if kind == "sinusoid":
        return [EXCITATIONS["sine"]]
    if kind == "rollout":
        return [EXCITATIONS[name] for name in BENCH_SCHEDULES["rollout"].excitations]
    return [replace(runs, method=kind)]


def coverage(made: np.ndarray, real: np.ndarray) -> float:
    """Share of ``real`` windows (n, F) with a made one (m, F) within their NEIGHBOURS nearest.

    Naeem et al., ICML 2020.
    """
    reach = np.sort(_distances(real, real), axis=1)[:, min(NEIGHBOURS, len(real) - 1)]
    return float(np.mean(_distances(real, made).min(axis=1) <= reach))


def nearest_signal(made: np.ndarray, train: np.ndarray) -> np.ndarray:
    """(n,) root mean square distance of windows (n, frames, CHANNELS) to the nearest of ``train``.

    Windows may be shifted by up to SHIFTS frames. Channels are divided by their standard deviation
    over ``train``.
    """
    scale = train.std(axis=(0, 1)) + 1e-9
    num_inner = made.shape[1] - 2 * SHIFTS
    inner = (made[:, SHIFTS : SHIFTS + num_inner] / scale).reshape(len(made), -1)

    squares = []
    for first in range(2 * SHIFTS + 1):
        shifted = (train[:, first : first + num_inner] / scale).reshape(len(train), -1)
        squares.append(
            np.sum(inner**2, axis=1)[:, None] - 2.0 * inner @ shifted.T + np.sum(shifted**2, axis=1)
        )
    return np.sqrt(np.maximum(np.min(squares, axis=(0, 2)), 0.0) / inner.shape[1])


def _distances(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.linalg.norm(left[:, None] - right[None], axis=2)


def likeness(runs: LearnedExcitation, test: LearnedExcitation, seed: int) -> Results:
    """Every kind of excitation against windows ``test`` of other runs, by joint class.

    Returns:
        Rows with the class in the column ``part`` and the kind in ``model``: ``auc`` of a
        classifier (0.5 is perfect), ``coverage`` of the test windows, ``nearest_signal``, and the
        median of each of FEATURES. ``nearest_signal`` is the distance of the signals to the
        training windows over that of the test windows, for the CLOSE nearest windows (1: like new
        data, far below 1: copies). Kind RUNS are the test windows themselves, TRAIN the training
        windows, without distance.
    """
    results: list[Result] = []
    for name in runs.classes:
        if name in test.classes:
            results += _likeness_of_class(runs, test, name, seed)
    return Results(results)


def _likeness_of_class(
    runs: LearnedExcitation, test: LearnedExcitation, name: str, seed: int
) -> list[Result]:
    train_windows = _windows_of_class(runs, name)
    test_windows = _windows_of_class(test, name)
    torque = test_windows[..., 1:].reshape(len(test_windows), -1)
    torque_rate = np.diff(torque, axis=1) * TORQUES_PER_FRAME / runs.period
    impact_rate = IMPACT * float(np.sqrt(np.mean(torque_rate**2))) + 1e-9
    train_features = features(train_windows, runs.period, impact_rate)
    test_features = features(test_windows, runs.period, impact_rate)

    results = _medians(RUNS, test_features, name)
    results += _against_runs(TRAIN, train_features, test_features, train_features, name, seed)
    results += _medians(TRAIN, train_features, name)
    for index, kind in enumerate(KINDS):
        rng = np.random.default_rng([seed, 61, index])
        windows = windows_of_kind(runs, kind, name, rng)
        kind_features = features(windows, runs.period, impact_rate)
        distance = np.quantile(nearest_signal(windows, train_windows), CLOSE)
        test_distance = np.quantile(nearest_signal(test_windows, train_windows), CLOSE)
        ratio = float(distance / test_distance)
        results.append(Result("nearest_signal", "1", ratio, kind, part=name))
        results += _against_runs(kind, kind_features, test_features, train_features, name, seed)
        results += _medians(kind, kind_features, name)
    return results


def _windows_of_class(excitation: LearnedExcitation, name: str) -> np.ndarray:
    return excitation.windows[excitation.window_class == excitation.classes.index(name)]


def _against_runs(
    kind: str,
    kind_features: np.ndarray,
    test_features: np.ndarray,
    train_features: np.ndarray,
    name: str,
    seed: int,
) -> list[Result]:
    """AUC and coverage of a kind."""
    auc = two_sample_auc(kind_features, test_features, seed)
    runs_features = np.concatenate([test_features, train_features])
    scaled, scaled_runs = standardise(kind_features, runs_features)
    covered = coverage(scaled, scaled_runs[: len(test_features)])
    return [
        Result("auc", "1", auc, kind, part=name),
        Result("coverage", "1", covered, kind, part=name),
    ]


def _medians(kind: str, kind_features: np.ndarray, name: str) -> list[Result]:
    """Median of each of FEATURES, in SI units."""
    results = []
    for feature, median in zip(FEATURES, np.median(kind_features, axis=0), strict=True):
        value = median if feature in LINEAR else np.exp(median)
        results.append(Result(feature, "SI", float(value), kind, part=name))
    return results
