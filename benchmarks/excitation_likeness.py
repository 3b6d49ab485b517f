"""How much an excitation is like the runs of a robot: a two-sample test on windows, and what it covers."""

from itertools import pairwise

import numpy as np

from motorprior.bench.recording import BENCH_SCHEDULES
from motorprior.excitation.frames import SUB
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
TRAIN = "train"  # the training windows themselves: what an excitation can reach at best
KINDS = ("sinusoid", "rollout", "surrogate", "recorded", "generated")


def features(windows: np.ndarray, period: float, impact_rate: float) -> np.ndarray:
    """(W, features) of windows (W, frames, 1 + SUB) with frames of ``period`` [s]; see FEATURES.

    An impact is a rise of |d torque/dt| above ``impact_rate`` [N·m/s], a reversal a change of the
    sign of the speed.
    """
    target = windows[..., 0]
    torque = windows[..., 1:].reshape(len(windows), -1)
    speed = np.diff(target, axis=1) / period
    acceleration = np.diff(speed, axis=1) / period
    rate = np.diff(torque, axis=1) * SUB / period
    power = (
        np.abs(
            np.fft.rfft((target - target.mean(axis=1, keepdims=True)) * np.hanning(target.shape[1]))
        )
        ** 2
    )
    at = np.fft.rfftfreq(target.shape[1], period)
    bands = [power[:, (at >= low) & (at < high)].sum(axis=1) for low, high in pairwise(BANDS)]
    sizes = [target.std(axis=1)]
    for signal in (speed, acceleration, torque):
        sizes += [np.sqrt(np.mean(signal**2, axis=1)), np.abs(signal).max(axis=1)]
    sizes[5:5] = bands
    sizes.append(np.sqrt(np.mean(rate**2, axis=1)))
    seconds = period * target.shape[1]
    above = np.abs(rate) > impact_rate
    moving = np.where(
        np.abs(speed) > 0.05 * np.abs(speed).max(axis=1, keepdims=True), np.sign(speed), 0.0
    )
    counts = [
        (~above[:, :-1] & above[:, 1:]).sum(axis=1) / seconds,
        np.array([np.count_nonzero(np.diff(row[row != 0.0])) for row in moving]) / seconds,
    ]
    return np.stack([*(np.log(np.maximum(size, 1e-6)) for size in sizes), *counts], axis=1)


def windows_of_kind(
    runs: LearnedExcitation, kind: str, joint_class: str, rng: np.random.Generator
) -> np.ndarray:
    """(COUNT, frames, 1 + SUB) windows of an excitation of ``KINDS`` for one class."""
    names = {"sinusoid": ("sine",), "rollout": BENCH_SCHEDULES["rollout"].excitations}.get(kind)
    sources = [EXCITATIONS[n] for n in names] if names else [runs.with_method(kind)]
    frames = runs.windows.shape[1]
    each = -(-COUNT // (STREAMS * len(sources)))
    parts = []
    for source in sources:
        made = source.streams(rng, each * frames * SUB, runs.period / SUB, [joint_class] * STREAMS)
        target = made.position_target.T.reshape(STREAMS, each * frames, SUB).mean(
            axis=2, keepdims=True
        )
        target = target - target.mean(axis=1, keepdims=True)
        torque = made.external_torque.T.reshape(STREAMS, each * frames, SUB)
        parts.append(
            np.concatenate([target, torque], axis=2).reshape(STREAMS * each, frames, 1 + SUB)
        )
    return rng.permutation(np.concatenate(parts))[:COUNT]


def coverage(made: np.ndarray, real: np.ndarray) -> float:
    """Share of ``real`` windows (n, F) with a made one (m, F) within their NEIGHBOURS nearest (Naeem, ICML 2020)."""
    reach = np.sort(_distances(real, real), axis=1)[:, min(NEIGHBOURS, len(real) - 1)]
    return float(np.mean(_distances(real, made).min(axis=1) <= reach))


def nearest_signal(made: np.ndarray, train: np.ndarray) -> np.ndarray:
    """(n,) root mean square difference of windows (n, frames, 1 + SUB) to the nearest of ``train`` at any shift.

    Channels are divided by their standard deviation over ``train``.
    """
    scale = train.std(axis=(0, 1)) + 1e-9
    inner = made.shape[1] - 2 * SHIFTS
    cut = (made[:, SHIFTS : SHIFTS + inner] / scale).reshape(len(made), -1)
    shifted = [
        (train[:, first : first + inner] / scale).reshape(len(train), -1)
        for first in range(2 * SHIFTS + 1)
    ]
    squares = [
        np.sum(cut**2, axis=1)[:, None] - 2.0 * cut @ each.T + np.sum(each**2, axis=1)
        for each in shifted
    ]
    return np.sqrt(np.maximum(np.min(squares, axis=(0, 2)), 0.0) / cut.shape[1])


def _distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.linalg.norm(one[:, None] - other[None], axis=2)


def likeness(runs: LearnedExcitation, test: LearnedExcitation, seed: int) -> Results:
    """Every kind of excitation against windows ``test`` of other runs, by joint class (the column ``part``).

    Returns:
        ``auc`` of a classifier (0.5 is perfect), ``coverage`` of the test windows,
        ``nearest_signal``: distance of the signals to the training windows over that of the test
        windows, for the CLOSE nearest windows (1: like new data, far below 1: copies), and the
        median of each of FEATURES; kind "runs" are the test windows themselves, TRAIN the training
        windows, without distance.
    """
    found: list[Result] = []
    for name in (each for each in runs.classes if each in test.classes):
        train, real = (
            own.windows[own.window_class == own.classes.index(name)] for own in (runs, test)
        )
        rate = np.diff(real[..., 1:].reshape(len(real), -1), axis=1) * SUB / runs.period
        limit = IMPACT * float(np.sqrt(np.mean(rate**2))) + 1e-9
        known, wanted = (features(windows, runs.period, limit) for windows in (train, real))
        for kind in ("runs", TRAIN, *KINDS):
            made = {"runs": wanted, TRAIN: known}.get(kind)
            if made is None:
                rng = np.random.default_rng([seed, 61, KINDS.index(kind)])
                windows = windows_of_kind(runs, kind, name, rng)
                made = features(windows, runs.period, limit)
                apart = [
                    np.quantile(nearest_signal(each, train), CLOSE) for each in (windows, real)
                ]
                found.append(
                    Result("nearest_signal", "1", float(apart[0] / apart[1]), kind, part=name)
                )
            if kind != "runs":
                found.append(
                    Result("auc", "1", two_sample_auc(made, wanted, seed), kind, part=name)
                )
                scaled, given = standardise(made, np.concatenate([wanted, known]))
                found.append(
                    Result("coverage", "1", coverage(scaled, given[: len(wanted)]), kind, part=name)
                )
            middle = np.median(made, axis=0)
            for index, feature in enumerate(FEATURES):
                value = middle[index] if feature in LINEAR else np.exp(middle[index])
                found.append(Result(feature, "SI", float(value), kind, part=name))
    return Results(found)
