"""Motions of servos that identify their motors, within the joints' limits.

A recording has parts for each joint alone, and for all joints together:

    sweep    slow, at a constant speed, for friction and gravity
    chirp    0.3 to 6 Hz and back, for inertia, gains and delay
    steps    fast reversals, for limits of torque, speed and profile
    holds    rest at several angles, under the load of gravity
    together multisines of all joints, for their coupling
"""

import math
from collections.abc import Callable, Sequence

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
_MIN_PART = 1.0  # [s]
# time of a hold [s]
_HOLD = 1.0
# parts of one joint, and of all joints, with their shares of the time
_ALONE = {"sweep": 0.3, "chirp": 0.35, "steps": 0.35}
_ALL = {"multisine": 0.4, "steps": 0.3, "holds": 0.3}

Signal = Callable[[Rng, int, float], np.ndarray]


def servo_parts(
    names: Sequence[str],
    lower: np.ndarray,
    upper: np.ndarray,
    nominal: np.ndarray | None,
    *,
    period: float,
    seconds: float = 120.0,
    amplitude: float = 0.5,
    seed: int = 0,
) -> list[MotionPart]:
    """The parts of a recording.

    Args:
        names: names of the n joints.
        lower: (n,) lower limits [rad].
        upper: (n,) upper limits [rad].
        nominal: (n,) pose about which the joints move [rad]; a joint that is nearer to a limit than
            the amplitude moves about an angle further away. None: about 0.
        period: control period [s].
        seconds: duration of all parts [s].
        amplitude: largest distance of a target from the center [rad]; less where a limit is near.
        seed: of the random signals.

    Raises:
        ConfigError: a value out of range, too little time for the parts, or a joint without
            room between its limits.
    """
    require_time(len(names), seconds)
    require_number("amplitude", amplitude, 0.0, 3.0, positive=True)
    require_seed(seed)
    room = 0.5 * (upper - lower) - _MARGIN
    if (room <= 0.0).any():
        joint = int(np.argmin(room))
        raise ConfigError(
            f"joint {names[joint]!r} has no room between its limits {lower[joint]:.2f} and "
            f"{upper[joint]:.2f} rad",
            remedy="check the position limits of its servo",
        )
    reach = np.minimum(amplitude, room)
    pose = np.zeros(len(names)) if nominal is None else nominal
    center = np.clip(pose, lower + _MARGIN + reach, upper - _MARGIN - reach)

    rng = np.random.default_rng([seed, _STREAM])
    joints = len(names)
    alone, together = _shares(joints, seconds)
    parts = []
    for joint, name in enumerate(names):
        for signal, share in _ALONE.items():
            steps = round(share * alone / period)
            away = np.zeros((steps, joints))
            away[:, joint] = _scaled(signal, rng, steps, period, reach[joint])
            parts.append(MotionPart(f"{name}: {signal}", center + away))
    for signal, share in _ALL.items():
        steps = round(share * together / period)
        if not steps:
            continue
        columns = [_scaled(signal, rng, steps, period, end) for end in reach]
        parts.append(MotionPart(f"all joints: {signal}", center + np.stack(columns, axis=1)))
    return parts


def require_time(joints: int, seconds: float) -> None:
    """Raise ConfigError if ``seconds`` [s] are too short for the parts of n joints."""
    require_number("seconds", seconds, 1.0, 3600.0)
    alone, _ = _shares(joints, seconds)
    shortest = min(_ALONE.values()) * alone
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


def _holds(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Levels in [-1, 1], each held for _HOLD, with ramps of the same time between them."""
    knots = np.arange(0.0, steps * dt + 2.0 * _HOLD, _HOLD)
    levels = np.repeat(rng.uniform(-1.0, 1.0, len(knots)), 2)[: len(knots)]
    return np.interp(np.arange(steps) * dt, knots, levels)


def _scaled(signal: str, rng: Rng, steps: int, period: float, reach: float) -> np.ndarray:
    """(steps,) a signal scaled to ``reach`` [rad], that begins and ends at 0.

    A sweep keeps to _SWEEP_SPEED, with less reach in a short time; the others are faded in and out.
    """
    values = _SIGNALS[signal](rng, steps, period)
    if signal == "sweep":
        return min(reach, 0.25 * _SWEEP_SPEED * steps * period) * values
    time = np.arange(steps) * period
    fade = np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)
    return reach * values / np.abs(values).max() * fade


_SIGNALS: dict[str, Signal] = {
    "sweep": _sweep,
    "chirp": chirp,
    "steps": held_steps,
    "multisine": multisine,
    "holds": _holds,
}
