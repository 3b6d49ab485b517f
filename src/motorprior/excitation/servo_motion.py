"""Motions of servos that identify their motors, within the joints' limits.

A recording has parts for each joint alone. Sweep and holds are played in a pose in which gravity
loads the joint, the others in the nominal pose:

    sweep    slow, at a constant speed, for friction and gravity
    holds    rest at both ends, for gains and the scale of torques
    chirp    0.3 to 6 Hz and back, for inertia, gains and delay
    steps    fast reversals, for limits of torque, speed and profile

Then all joints move together: multisines for their coupling, steps, and holds at several angles.
Slow ways lead from one pose to the next, always by the nominal pose.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.excitation.excitation import Rng
from motorprior.excitation.hand_made import chirp, held_steps, multisine
from motorprior.robots.servos import MotionPart

_MARGIN = 0.1  # distance of targets from the joints' limits [rad]
_FADE = 0.5  # time in which the amplitude grows from 0, and returns to it [s]
_STREAM = 0x5E71
# share of the recording of all joints together, if there are several
_TOGETHER = 0.4
_SWEEP_SPEED = 0.25  # [rad/s]
_WAY_SPEED = 0.5  # [rad/s]
_MIN_PART = 1.0  # [s]
# time of a hold of all joints [s]
_HOLD = 1.0
# parts of one joint, under load and in the nominal pose, and of all joints; shares of their time
_LOADED = {"sweep": 0.25, "holds at both ends": 0.25}
_NOMINAL = {"chirp": 0.25, "steps": 0.25}
_ALL = {"multisine": 0.4, "steps": 0.3, "holds": 0.3}

Signal = Callable[[Rng, int, float], np.ndarray]


class MotionRange(NamedTuple):
    """Where n joints move, in rad, (n,) each."""

    lowest: np.ndarray  # of the middle of a motion
    highest: np.ndarray
    center: np.ndarray  # the nominal pose, or the nearest one in this range
    reach: np.ndarray  # largest distance from the middle


def motion_range(
    names: Sequence[str],
    lower: np.ndarray,
    upper: np.ndarray,
    nominal: np.ndarray | None,
    amplitude: float,
) -> MotionRange:
    """Where joints move by ``amplitude`` [rad], less where their limits are near.

    Args:
        names: names of the n joints.
        lower: (n,) lower limits [rad].
        upper: (n,) upper limits [rad].
        nominal: (n,) pose about which the joints move [rad]; a joint that is nearer to a limit than
            the amplitude moves about an angle further away. None: about 0.
        amplitude: largest distance of a target from the middle of its motion [rad].

    Raises:
        ConfigError: a value out of range, or a joint without room between its limits.
    """
    require_number("amplitude", amplitude, 0.0, 3.0, positive=True)
    room = 0.5 * (upper - lower) - _MARGIN
    if (room <= 0.0).any():
        joint = int(np.argmin(room))
        raise ConfigError(
            f"joint {names[joint]!r} has no room between its limits {lower[joint]:.2f} and "
            f"{upper[joint]:.2f} rad",
            remedy="check the position limits of its servo",
        )
    reach = np.minimum(amplitude, room)
    lowest = lower + _MARGIN + reach
    highest = np.maximum(lowest, upper - _MARGIN - reach)  # equal, but for rounding, without room
    pose = np.zeros(len(names)) if nominal is None else nominal
    return MotionRange(lowest, highest, np.clip(pose, lowest, highest), reach)


def servo_parts(
    names: Sequence[str],
    motion: MotionRange,
    loaded: np.ndarray | None = None,
    *,
    period: float,
    seconds: float = 120.0,
    seed: int = 0,
) -> list[MotionPart]:
    """The parts of a recording.

    Args:
        names: names of the n joints.
        motion: where they move.
        loaded: (n, n) pose in row j about which joint j sweeps and holds [rad]; None: ``motion``'s.
        period: control period [s].
        seconds: duration of all parts, without the ways between poses [s].
        seed: of the random signals.

    Raises:
        ConfigError: a value out of range, or too little time for the parts.
    """
    require_time(len(names), seconds)
    require_seed(seed)
    center = motion.center
    poses = np.tile(center, (len(names), 1)) if loaded is None else loaded
    rng = np.random.default_rng([seed, _STREAM])
    alone, together = _shares(len(names), seconds)

    parts = []
    for joint, name in enumerate(names):
        reach = motion.reach[joint]
        if joint == 0 or (poses[joint] != poses[joint - 1]).any():
            previous = center if joint == 0 else poses[joint - 1]
            parts += _ways([previous, center, poses[joint]], f"way to {name}", period)
        for signal, share in _LOADED.items():
            values = _scaled(signal, rng, round(share * alone / period), period, reach)
            parts.append(_of_joint(f"{name}: {signal}", poses[joint], joint, values))
    parts += _ways([poses[-1], center], "way to the nominal pose", period)

    for joint, name in enumerate(names):
        for signal, share in _NOMINAL.items():
            values = _scaled(
                signal, rng, round(share * alone / period), period, motion.reach[joint]
            )
            parts.append(_of_joint(f"{name}: {signal}", center, joint, values))
    for signal, share in _ALL.items():
        steps = round(share * together / period)
        if not steps:
            continue
        columns = [_scaled(signal, rng, steps, period, end) for end in motion.reach]
        parts.append(MotionPart(f"all joints: {signal}", center + np.stack(columns, axis=1)))
    return parts


def _of_joint(name: str, pose: np.ndarray, joint: int, values: np.ndarray) -> MotionPart:
    """A part in which one joint moves by (steps,) ``values`` [rad] about a pose."""
    targets = np.tile(pose, (len(values), 1))
    targets[:, joint] += values
    return MotionPart(name, targets)


def _ways(poses: Sequence[np.ndarray], name: str, period: float) -> list[MotionPart]:
    """The slow way along the straight lines between poses, as a part; none if they are equal."""
    lines = []
    for begin, end in pairwise(poses):
        distance = float(np.abs(end - begin).max())
        if distance == 0.0:
            continue
        steps = math.ceil(0.5 * math.pi * distance / (_WAY_SPEED * period))
        share = 0.5 - 0.5 * np.cos(math.pi * np.arange(1, steps + 1) / steps)
        lines.append(begin + share[:, None] * (end - begin))
    return [MotionPart(name, np.concatenate(lines))] if lines else []


def require_time(joints: int, seconds: float) -> None:
    """Raise ConfigError if ``seconds`` [s] are too short for the parts of n joints."""
    require_number("seconds", seconds, 1.0, 3600.0)
    alone, _ = _shares(joints, seconds)
    shortest = min(*_LOADED.values(), *_NOMINAL.values()) * alone
    if shortest < _MIN_PART:
        raise ConfigError(
            f"seconds {seconds:g} is too short for {joints} joints",
            remedy=f"give at least {math.ceil(seconds * _MIN_PART / shortest)}",
            argument="seconds",
        )


def _shares(joints: int, seconds: float) -> tuple[float, float]:
    """Time of each joint alone, and of all joints together [s]."""
    together = _TOGETHER * seconds if joints > 1 else 0.0
    return (seconds - together) / joints, together


def _sweep(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """One period of a triangle between -1 and 1 that begins and ends at 0."""
    phase = np.arange(steps) / max(1, steps - 1)
    return 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase))


def _both_ends(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """A hold at 1 and a hold at -1; ramps before, between and after them take as long."""
    phase = np.linspace(0.0, 1.0, steps)
    return np.interp(phase, np.arange(6) / 5.0, [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])


def _holds(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Levels in [-1, 1], each held for _HOLD, with ramps of the same time between them."""
    knots = np.arange(0.0, steps * dt + 2.0 * _HOLD, _HOLD)
    levels = np.repeat(rng.uniform(-1.0, 1.0, len(knots)), 2)[: len(knots)]
    return np.interp(np.arange(steps) * dt, knots, levels)


def _scaled(signal: str, rng: Rng, steps: int, period: float, reach: float) -> np.ndarray:
    """(steps,) a signal scaled to ``reach`` [rad], that begins and ends at 0.

    A sweep keeps to _SWEEP_SPEED, with less reach in a short time; random signals and chirps are
    faded in and out.
    """
    values = _SIGNALS[signal](rng, steps, period)
    if signal == "sweep":
        return min(reach, 0.25 * _SWEEP_SPEED * steps * period) * values
    if signal == "holds at both ends":
        return reach * values
    time = np.arange(steps) * period
    fade = np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)
    return reach * values / np.abs(values).max() * fade


_SIGNALS: dict[str, Signal] = {
    "sweep": _sweep,
    "holds at both ends": _both_ends,
    "chirp": chirp,
    "steps": held_steps,
    "multisine": multisine,
    "holds": _holds,
}
