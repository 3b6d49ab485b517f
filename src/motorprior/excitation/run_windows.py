"""Windows of the motion of a robot's joints, cut from logs of its runs, by joint class."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import inf

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError
from motorprior.excitation.bounded_stream import Bounds
from motorprior.excitation.frames import TORQUES_PER_FRAME
from motorprior.excitation.learned_excitation import UNKNOWN_LOAD, LearnedExcitation
from motorprior.logs.motor_log import MotorLog, motion_digest
from motorprior.logs.operations import EXCITED_STD, resample
from motorprior.robots.joint_classes import position_classes

SECONDS = 1.28  # duration of a window [s]: two to four steps of a leg
# [s]: with a longer one, a window has too few frames for the generator's critic
MAX_CONTROL_PERIOD = 0.04
OVERLAP = 4  # windows that contain a row
MAX_WINDOWS = 400  # maximum number per class in the file
MIN_SCALE = 1e-6  # standard deviation of a channel that is constant in the runs
# Bounds of amplitude, speed, acceleration and torque, relative to the largest values in the runs.
# Below these, streams of recorded windows are not distorted (`bounded_stream` divides the
# acceleration between its two stages).
BOUND_FACTORS = (1.25, 1.25, 3.0, 1.25)
MIN_BOUNDS = (1e-2, 1e-1, 1.0, 1e-3)  # a joint without external torque has almost none
MAX_PERIOD = 2.0  # largest period of a gait [s]
YIN_THRESHOLD = 0.1  # below which a valley of the YIN estimator is a period


@dataclass(frozen=True)
class _Window:
    """A window of one joint."""

    frames: np.ndarray  # (frames, CHANNELS)
    long_target: np.ndarray  # target of the window, and of as many frames before and after it
    command: float  # commanded speed of the run [m/s]
    load_inertia: float  # [kg·m²]; 0 if unknown


def windows_of(
    logs: Sequence[MotorLog], period: float, commands: Sequence[float] = ()
) -> LearnedExcitation:
    """The windows of runs, as an excitation that plays them.

    Windows with a static target are left out.

    Args:
        logs: of the runs.
        period: control period [s].
        commands: commanded speed of each run [m/s]; none if unknown.

    Raises:
        ConfigError, LogError: see `fit_excitation`.
    """
    _check(logs, period, commands)
    windows_by_class: dict[str, list[_Window]] = {}
    for log, command in zip(logs, commands or [0.0] * len(logs), strict=True):
        for joint_class, window in _windows_of_log(log, period, command):
            windows_by_class.setdefault(joint_class, []).append(window)
    if not windows_by_class:
        raise LogError(
            f"no window of {SECONDS:g} s with a moving joint",
            where=logs[0].source,
            remedy="record longer runs, or runs that move",
        )

    load_ranges = [_load_range(windows) for windows in windows_by_class.values()]
    saved_windows = [_thinned(windows) for windows in windows_by_class.values()]
    frames_of_classes = []
    for windows in saved_windows:
        frames_of_classes.append(np.stack([window.frames for window in windows]))
    all_windows = list(chain.from_iterable(saved_windows))
    all_frames = np.concatenate(frames_of_classes)

    trained_on = [
        {
            "source": log.source,
            "robot": log.robot,
            "seconds": log.duration,
            "motion": motion_digest(log),
        }
        for log in logs
    ]
    return LearnedExcitation(
        "recorded",
        tuple(windows_by_class),
        period,
        all_frames,
        window_class=np.repeat(
            np.arange(len(saved_windows)), [len(windows) for windows in saved_windows]
        ),
        commands=np.array([window.command for window in all_windows], float),
        frequency=np.array([gait_frequency(window.long_target, period) for window in all_windows]),
        scales=np.array(
            [np.maximum(frames.std(axis=(0, 1)), MIN_SCALE) for frames in frames_of_classes]
        ),
        bounds=np.array([_bounds(frames, period) for frames in frames_of_classes]),
        load_inertia=np.array(load_ranges),
        provenance={
            "trained_on": trained_on,
            "commands": list(commands),
            "period": period,
            "windows_sha256": hashlib.sha256(all_frames.tobytes()).hexdigest(),
        },
    )


def _check(logs: Sequence[MotorLog], period: float, commands: Sequence[float]) -> None:
    require_number("period", period, 1e-4, MAX_CONTROL_PERIOD)
    if not logs or len(commands) not in (0, len(logs)):
        raise ConfigError(
            f"{len(commands)} commands for {len(logs)} runs",
            remedy="give runs, and one command per run or none",
            argument="commands",
        )
    for command in commands:
        require_number("commands", command, minimum=-10.0, maximum=10.0)


def _windows_of_log(log: MotorLog, period: float, command: float) -> list[tuple[str, _Window]]:
    """Class and window, of all moving joints and segments."""
    num_frames = round(SECONDS / period)
    classes = position_classes(log.joint_names, log.given_classes)

    windows = []
    for segment in log.segments():
        if segment.duration <= SECONDS:
            continue
        grid = resample(segment, period / TORQUES_PER_FRAME)
        for joint, joint_class in enumerate(classes):
            frames = _frames(grid, joint)
            load_inertia = 0.0
            if grid.load_inertia is not None:
                load_inertia = float(np.median(grid.load_inertia[:, joint]))

            for first in range(0, len(frames) - num_frames + 1, num_frames // OVERLAP):
                end = first + num_frames
                if frames[first:end, 0].std() <= EXCITED_STD:
                    continue
                long_target = frames[max(0, first - num_frames) : end + num_frames, 0]
                window = _Window(frames[first:end], long_target, command, load_inertia)
                windows.append((joint_class, window))
    return windows


def _frames(grid: MotorLog, joint: int) -> np.ndarray:
    """(frames, CHANNELS) of a joint of one segment on the grid of external torques."""
    num_frames = grid.num_rows // TORQUES_PER_FRAME
    num_rows = num_frames * TORQUES_PER_FRAME
    targets = grid.position_target[:num_rows, joint].reshape(num_frames, TORQUES_PER_FRAME)
    target = targets.mean(axis=1)
    external = grid.external_torque
    if external is None:
        external = np.zeros_like(grid.position_target)
    torque = external[:num_rows, joint].reshape(num_frames, TORQUES_PER_FRAME)
    return np.column_stack([target - target.mean(), torque])


def _load_range(windows: Sequence[_Window]) -> tuple[float, float]:
    """Lowest and highest load inertia [kg·m²]; UNKNOWN_LOAD if no run has loads."""
    loads = [window.load_inertia for window in windows if window.load_inertia > 0.0]
    if not loads:
        return UNKNOWN_LOAD, UNKNOWN_LOAD
    return min(loads), max(loads)


def _thinned(windows: Sequence[_Window]) -> list[_Window]:
    """At most MAX_WINDOWS of the windows, evenly spaced."""
    positions = np.unique(np.linspace(0, len(windows) - 1, MAX_WINDOWS).astype(int))
    return [windows[position] for position in positions]


def _bounds(frames: np.ndarray, period: float) -> Bounds:
    """Bounds of a class from its windows (n, frames, CHANNELS)."""
    target = frames[..., 0]
    largest = (
        np.abs(target).max(),
        np.abs(np.diff(target)).max() / period,
        np.abs(np.diff(target, n=2)).max() / period**2,
        np.abs(frames[..., -TORQUES_PER_FRAME:]).max(),
    )
    return Bounds(*np.maximum(np.array(BOUND_FACTORS) * largest, MIN_BOUNDS))


def gait_frequency(target: np.ndarray, period: float) -> float:
    """Gait frequency of a target (frames,) [Hz], by the YIN estimator.

    YIN: de Cheveigné & Kawahara, J. Acoust. Soc. Am. 111, 2002. A motion that is not periodic gets
    the lowest frequency, of the longest lag.
    """
    lags = np.arange(1, min(len(target) // 2, round(MAX_PERIOD / period)))
    difference = np.array([np.mean((target[lag:] - target[:-lag]) ** 2) for lag in lags])
    difference *= lags / np.maximum(np.cumsum(difference), 1e-12)

    falls = difference[1:-1] <= difference[:-2]
    rises = difference[1:-1] < difference[2:]
    valleys = 1 + np.flatnonzero(falls & rises)
    threshold = max(YIN_THRESHOLD, 1.5 * difference[valleys].min(initial=inf))
    deep = valleys[difference[valleys] <= threshold]
    best = deep[0] if len(deep) else len(lags) - 1

    # the vertex of a parabola through the valley and its neighbours
    around = np.clip([best - 1, best, best + 1], 0, len(difference) - 1)
    left, middle, right = difference[around]
    vertex = 0.5 * (left - right) / max(left - 2.0 * middle + right, 1e-12)
    return 1.0 / (period * (lags[best] + float(np.clip(vertex, -0.5, 0.5))))
