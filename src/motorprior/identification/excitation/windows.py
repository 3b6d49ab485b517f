"""Windows of runs of a robot, per joint class: position targets, and what the load did to the joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motorprior.bench.bounded_stream import Bounds
from motorprior.bench.learned_excitation import LearnedExcitation
from motorprior.bench.stream_makers import CHANNELS, SUB
from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints, resample
from motorprior.robots.joint_classes import classes_by_name

SECONDS = 1.28  # of a window: two to four steps of a leg
OVERLAP = 4  # windows that contain a row
MAX_WINDOWS = 400  # of a class in the file
MARGIN = 1.25  # bounds over the largest values in the runs
UNLOADED = (1e-4, 3e-2)  # load inertia where no run states one [kg·m²]
_FLOORS = (1e-2, 1e-1, 1.0, 1e-3)  # of the bounds: a joint without external torque has almost none


def windows_of(
    logs: Sequence[MotorLog], period: float, commands: Sequence[float] = (), seconds: float = SECONDS
) -> LearnedExcitation:
    """The windows of runs with a control period of ``period`` [s], played by themselves.

    ``commands`` are the commanded speeds of the runs [m/s]. Static joints are left out. Raises `LogError` if no segment
    with a moving joint is as long as a window.
    """
    frames = round(seconds / period)
    rows: list[tuple[str, float, np.ndarray]] = []
    inertia: dict[str, list[float]] = {}
    for log, command in zip(logs, commands or [0.0] * len(logs), strict=True):
        by_name = classes_by_name(log.joint_names)  # places on the robot, whatever the motors
        kinds = by_name if any(by_name) else log.joint_names
        for segment in (each for each in log.segments() if each.duration > seconds):
            grid = resample(segment, period / SUB)
            for joint in excited_joints(segment).tolist():
                rows += [(kinds[joint], command, window) for window in _cut(grid, joint, frames)]
                if grid.load_inertia is not None:
                    inertia.setdefault(kinds[joint], []).append(float(np.median(grid.load_inertia[:, joint])))
    if not rows:
        remedy = "record longer runs, or runs that move"
        raise LogError(f"no segment of {seconds:g} s with a moving joint", where=logs[0].source, remedy=remedy)
    classes = tuple(dict.fromkeys(kind for kind, _, _ in rows))
    kept = [row for kind in classes for row in _spread([row for row in rows if row[0] == kind])]
    which, windows = np.array([classes.index(kind) for kind, _, _ in kept]), np.stack([row[2] for row in kept])
    of_class = [windows[which == kind] for kind in range(len(classes))]
    ranges = [(min(inertia[kind]), max(inertia[kind])) if kind in inertia else UNLOADED for kind in classes]
    return LearnedExcitation(
        "recorded", classes, period, windows, which,
        np.array([command for _, command, _ in kept], float), _frequency(windows[..., 0], period),
        np.array([np.maximum(own.std(axis=(0, 1)), 1e-6) for own in of_class]),
        np.array([_bounds(own, period) for own in of_class]), np.array(ranges),
    )  # fmt: skip


def _cut(grid: MotorLog, joint: int, frames: int) -> list[np.ndarray]:
    """(frames, CHANNELS) windows of a joint of one segment on the grid of external torques."""
    count = grid.num_rows // SUB
    target = grid.position_target[: count * SUB, joint].reshape(count, SUB).mean(axis=1)
    torque = np.zeros((count, SUB))
    if grid.external_torque is not None:
        torque = grid.external_torque[: count * SUB, joint].reshape(count, SUB)
    whole = np.concatenate([target[:, None] - target.mean(), torque], axis=1)
    return [whole[first : first + frames] for first in range(0, count - frames + 1, frames // OVERLAP)]


def _spread(rows: list) -> list:
    return [rows[index] for index in np.unique(np.linspace(0, len(rows) - 1, MAX_WINDOWS).astype(int))]


def _bounds(windows: np.ndarray, period: float) -> Bounds:
    target = windows[..., 0]
    found = (
        np.abs(target).max(), np.abs(np.diff(target)).max() / period,
        np.abs(np.diff(target, n=2)).max() / period**2, np.abs(windows[..., -(CHANNELS - 1) :]).max(),
    )  # fmt: skip
    return Bounds(*np.maximum(MARGIN * np.array(found), _FLOORS))


def _frequency(targets: np.ndarray, period: float) -> np.ndarray:
    """(W,) frequency of the largest component of targets (W, frames) [Hz], interpolated by zero padding."""
    size = 8 * targets.shape[1]
    away = (targets - targets.mean(axis=1, keepdims=True)) * np.hanning(targets.shape[1])
    return np.fft.rfftfreq(size, period)[1:][np.abs(np.fft.rfft(away, n=size))[:, 1:].argmax(axis=1)]
