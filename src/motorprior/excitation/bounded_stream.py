"""Position targets that cannot exceed bounds of amplitude A, speed V and acceleration W.

A raw signal x_k [rad] of any size is followed by a state (s, v) with period dt:

    w  = soft_clip((x_{k+1} - x_k) / dt + RETURN·(x_k - s_k), U)         |w| <= U
    v' = v + soft_clip(w - v, B·dt)                                      |v'| <= U, |v' - v| <= B·dt
    s' = s + dt·v'
    q  = soft_clip(s, A)                                                 |q| < A

`soft_clip` is the identity up to 80 % of its bound and saturates with tanh. Its slope is at most 1
and its curvature at most CURVE / A, so that |q' - q| <= U·dt and |q'' - 2q' + q| <= B·dt² +
CURVE·(U·dt)²/A. With

    U = min(V, √(W·A / (2·CURVE))),   B = W - CURVE·U²/A

these are V·dt and W·dt². v' lies between v and w, since soft_clip shrinks. s follows x exactly
while both clips of the step are the identity, so that signals well inside the bounds are kept.
"""

from typing import Any, NamedTuple

import numpy as np

RETURN = 5.0  # rate at which s returns to x [1/s]
KNEE = 0.8  # share of the bound below which `soft_clip` is the identity
CURVE = 4 / (3 * 3**0.5) / (1 - KNEE)  # maximum of |soft_clip''| times its bound


class Bounds(NamedTuple):
    """Bounds of n joints, arrays of the same shape."""

    amplitude: Any  # [rad] from the centre of the motion
    speed: Any  # [rad/s]
    acceleration: Any  # [rad/s²]
    torque: Any  # external torque [N·m]


def soft_clip(value: Any, bound: Any) -> Any:
    """``value`` clipped softly to ±``bound``.

    With b for ``bound``, values up to KNEE·b are kept. Larger ones become
    ±b·(KNEE + (1 - KNEE)·tanh((|value|/b - KNEE)/(1 - KNEE))).
    """
    knee = KNEE * bound
    headroom = (1.0 - KNEE) * bound
    over = np.maximum(np.abs(value) - knee, 0.0)
    return np.clip(value, -knee, knee) + np.sign(value) * headroom * np.tanh(over / headroom)


def bounded(raw: np.ndarray, bounds: Bounds, dt: float) -> np.ndarray:
    """(steps, n) bounded targets [rad] that follow ``raw`` (steps + 1, n).

    They start at rest at its first row.
    """
    amplitude = bounds.amplitude
    # U and B·dt of the module's formulas
    speed = np.minimum(bounds.speed, np.sqrt(bounds.acceleration * amplitude / (2.0 * CURVE)))
    speed_change = (bounds.acceleration - CURVE * speed**2 / amplitude) * dt

    position = raw[0]
    velocity = np.zeros_like(raw[0])
    targets = np.empty_like(raw[1:])
    for row in range(len(targets)):
        speed_of_raw = (raw[row + 1] - raw[row]) / dt
        followed = soft_clip(speed_of_raw + RETURN * (raw[row] - position), speed)

        velocity = velocity + soft_clip(followed - velocity, speed_change)
        position = position + dt * velocity
        targets[row] = soft_clip(position, amplitude)
    return targets
