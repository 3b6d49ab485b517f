"""Whether joint_torque is the one that moved a known load.

    needed = load_inertia·q̈ - external_torque          as means over WINDOW
    needed = slope·joint_torque + coulomb·tanh(q̇/SLOW) + viscous·q̇,    coulomb ≤ 0, viscous ≤ 0

A torque that is computed from a current is not yet less by the friction of the gear, so that slope, coulomb and viscous
are fitted together, wherever the slope alone does not do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.doctor.sensor_checks import encoder_step
from motorprior.logs.motor_log import MotorLog, time_steps

WINDOW = 0.05
"""Torques are compared as means over so long a time, or the noise of accelerations hides everything [s]."""
SLOPE = (0.7, 1.4)
"""Torque of the load over joint_torque that passes [-]."""
MIN_CORRELATION = 0.7
SLOW = 0.05
"""Speed at which Coulomb friction is nearly whole [rad/s]."""
MOST_NOISE = 0.3
"""Noise of the inertia's torque, as a share of what the load needed, up to which angles tell accelerations."""
_MIN_WINDOWS = 20
_FOURTH, _SECOND = np.sqrt(70.0), np.sqrt(6.0)
"""Standard deviation of fourth and second differences of noise of 1."""


@dataclass(frozen=True, eq=False)
class _Windows:
    """Means over windows of all segments, each (windows, J).

    Attributes:
        measured: joint_torque [N·m].
        needed: torque that the load needed [N·m].
        speed: of the joint [rad/s].
        noise: (J,) standard deviation of ``needed`` that comes from noise of the angles [N·m]; 0 with joint_vel.
    """

    measured: np.ndarray
    needed: np.ndarray
    speed: np.ndarray
    noise: np.ndarray


def torque_and_load(log: MotorLog) -> tuple[list[Finding], frozenset[str]]:
    """joint_torque against the torque that the known load needed, joint by joint.

    Without joint_vel the accelerations are second differences of the angles over WINDOW, where these are clean enough.

    Returns:
        What was found, and the names of the joints that were judged: none of a log without loads or torques.
    """
    if log.joint_torque is None or log.load_inertia is None or log.external_torque is None:
        return [], frozenset()
    seen = _windows(log)
    if len(seen.measured) < _MIN_WINDOWS:
        return [], frozenset()
    size = np.sqrt(np.mean(seen.needed**2, axis=0))
    clear = (size > 0.0) & (seen.noise <= MOST_NOISE * size) & seen.measured.any(axis=0)
    judged = [column for column in excited_joints(log) if clear[column]]
    found = []
    for column in judged:
        columns = (each[:, column] for each in (seen.measured, seen.needed, seen.speed))
        finding = _finding(log.joint_names[column], *columns)
        found += [] if finding is None else [finding]
    return found, frozenset(log.joint_names[column] for column in judged)


def _windows(log: MotorLog) -> _Windows:
    parts = [_means(part) for part in log.segments()]
    measured, needed, speed = (np.concatenate(columns) for columns in list(zip(*parts, strict=True))[:3])
    windows = [len(part[0]) if np.isfinite(part[3]).all() else 0 for part in parts]  # too short a part tells no noise
    noise = np.full(log.num_joints, np.inf)
    if any(windows):
        known = [part[3] ** 2 for part, count in zip(parts, windows, strict=True) if count]
        noise = np.sqrt(np.average(known, axis=0, weights=[count for count in windows if count]))
    return _Windows(measured, needed, speed, noise)


def _means(part: MotorLog) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The columns of `_Windows` of one segment."""
    assert part.joint_torque is not None and part.load_inertia is not None and part.external_torque is not None
    length = max(1, round(WINDOW / float(np.median(time_steps(part)[1]))))
    speed = _slopes(part.joint_pos, part.time, length)
    if part.joint_vel is None:
        acceleration = _slopes(speed, part.time[: len(speed)], length)[::length]
        speed, noise = _mean(speed, length), _noise(part.joint_pos) * np.mean(part.load_inertia, axis=0)
        means = (_mean(_mean(values, length), length) for values in (part.joint_torque, part.external_torque))
    else:
        acceleration, noise = _slopes(part.joint_vel, part.time, length)[::length], np.zeros(part.num_joints)
        means = (_mean(values, length) for values in (part.joint_torque, part.external_torque))
    torque, external = (values[::length][: len(acceleration)] for values in means)
    inertia = part.load_inertia[::length][: len(acceleration)]
    return torque, inertia * acceleration - external, speed[::length][: len(acceleration)], noise


def _noise(angle: np.ndarray) -> np.ndarray:
    """(J,) standard deviation of second differences of angles over WINDOW [rad/s²], were they only noise."""
    if len(angle) < _MIN_WINDOWS:
        return np.full(angle.shape[1], np.inf)
    steps = np.array([encoder_step(column) for column in angle.T]) / np.sqrt(12.0)  # of an even spread over a step
    return np.maximum(np.std(np.diff(angle, 4, axis=0), axis=0) / _FOURTH, steps) * _SECOND / WINDOW**2


def _mean(values: np.ndarray, length: int) -> np.ndarray:
    """(T - length + 1, J) means of ``length`` rows each."""
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return (total[length:] - total[:-length]) / length


def _slopes(values: np.ndarray, time: np.ndarray, length: int) -> np.ndarray:
    """(T - length, J) changes per second over ``length`` rows."""
    return (values[length:] - values[:-length]) / (time[length:] - time[:-length])[:, None]


def _fit(needed: np.ndarray, *terms: np.ndarray) -> tuple[float, float]:
    """Slope of the first of these terms, and correlation of the least squares in which the others only resist."""
    best = 0.0, 0.0
    for chosen in range(2 ** (len(terms) - 1)):
        used = [terms[0], *(term for index, term in enumerate(terms[1:]) if chosen >> index & 1)]
        factors = np.linalg.lstsq(np.stack(used, axis=1), needed, rcond=None)[0]
        if np.any(factors[1:] > 0.0):
            continue
        explained = float(np.dot(needed, np.stack(used, axis=1) @ factors) / max(np.dot(needed, needed), 1e-300))
        correlation = float(np.sqrt(max(0.0, explained))) * (1.0 if factors[0] >= 0.0 else -1.0)
        best = max(best, (float(factors[0]), correlation), key=lambda found: abs(found[1]))
    return best


def _passes(slope: float, correlation: float) -> bool:
    return correlation >= MIN_CORRELATION and SLOPE[0] <= slope <= SLOPE[1]


def _finding(joint: str, measured: np.ndarray, needed: np.ndarray, speed: np.ndarray) -> Finding | None:
    slope, correlation = _fit(needed, measured)
    if _passes(slope, correlation) or _passes(*_fit(needed, measured, np.tanh(speed / SLOW), speed)):
        return None
    beside = "also with friction beside it"
    if correlation < MIN_CORRELATION:
        remedy = (
            "check the load, the clocks of both, and the sign of the torque; turn it in the file, or "
            f"{IN_MAP} by [joints.….joint_torque]; a torque from a current is no joint's torque where the gear takes "
            "most of it: leave it out"
        )
        message = f"joint_torque/{joint} is not the torque that moved its load, {beside}: correlation {correlation:.2f}"
        return Finding("warning", "load", correlation, MIN_CORRELATION, message, remedy, joint, row=0)
    remedy = (
        "check the load_inertia, the torque constant and the unit of the torque, and whether a gear takes part of it; "
        f"convert it in the file, or {IN_MAP} by torque"
    )
    message = f"the load of {joint} needed {slope:.2f} times its joint_torque, {beside}"
    return Finding("warning", "load", slope, SLOPE[int(slope > 1.0)], message, remedy, joint, row=0)
