"""Whether the signs of a log's angles are the robot's model's: by the weight that its motors hold.

A motor that follows its command steadily is off it by what its torque needs,

    position_target - joint_pos = -(torque of gravity)/kp + friction·sign(speed) + lag·speed + offset,   kp >= 0

fitted joint by joint. What this leaves is compared with what it leaves where the signs of one joint or of two are
turned: the model's gravity is then that of other angles, and pulls those joints the other way. The offset is bounded,
because command and angle are of one encoder, and without a bound it would take the place of all gravity that hardly
changes. Axes that stand upright, and joints that carry next to nothing, show nothing here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog

Gravity = Callable[[np.ndarray], np.ndarray]
"""Torque of gravity on every joint (N, J) [N·m], at angles (N, J) [rad]."""
MARGIN = 0.25
"""Other signs leave so much less of the squared error, as a share. Of 40 motions of a real arm whose signs are right,
the worst has 0.14, and the median 0."""
LEAST = 2e-3
"""And the error that is left becomes smaller by so much, root mean square of all joints together [rad]."""
WINDOW = 0.2
"""Speeds are taken over so long a time [s]."""
SLOWEST, FASTEST = 0.03, 0.5
"""Of the rows that count [rad/s]: friction of a joint at rest may pull either way, and a fast one is not steady."""
STEADY = 0.05
"""Largest difference of the speeds of command and angle [rad/s]."""
OFFSET = 0.01
"""Largest offset of command and angle [rad]."""
ALIKE = 0.05
"""Signs of fewer joints are named where they lack no more than this share of what the best ones gain."""
MOST_TRIED, MOST_ROWS, FEWEST_ROWS = 20_000, 500, 20
"""Rows that are looked at, those of them that count, and the fewest of a joint."""


@dataclass(frozen=True, eq=False)
class _Steady:
    """N rows in which some joint moves steadily: angles [rad], errors [rad], speeds [rad/s] and which joints do."""

    angle: np.ndarray
    error: np.ndarray
    speed: np.ndarray
    moves: np.ndarray


def signs(log: MotorLog, gravity: Gravity) -> list[Finding]:
    """Which signs of one joint or of two, turned, let gravity explain the errors of steady motion clearly better.

    Args:
        log: of a robot whose base is held.
        gravity: of its model.
    """
    steady = _steady(log)
    if steady.moves.sum(axis=0).max(initial=0) < FEWEST_ROWS:
        return []
    own = _left(steady, gravity, ())
    if np.sqrt(own) < LEAST:
        return []
    left = {(): own} | {turned: _left(steady, gravity, turned) for turned in _some(log.num_joints)}
    least = min(left.values())
    turned = next(some for some, rest in left.items() if rest <= least + ALIKE * (own - least))
    if left[turned] > (1.0 - MARGIN) * own or np.sqrt(own) - np.sqrt(left[turned]) < LEAST:
        return []
    return [_finding([log.joint_names[column] for column in turned], own, left[turned])]


def _some(count: int) -> Iterator[tuple[int, ...]]:
    """Each joint, and each two."""
    for size in (1, 2):
        yield from combinations(range(count), size)


def _finding(joints: list[str], own: float, other: float) -> Finding:
    names, plural = " and ".join(joints), "s" if len(joints) > 1 else ""
    share, (before, after) = 1.0 - other / own, 1e3 * np.sqrt([own, other])
    message = (
        f"gravity of the robot's model leaves {before:.1f} mrad of the errors of steady motion unexplained, and "
        f"{after:.1f} mrad with the sign{plural} of {names} turned"
    )
    remedy = (
        f"look whether the base stands as in the model, and which way {names} turn{'' if plural else 's'} there; turn "
        f"the sign in the file, or {IN_MAP} by sign, or turn the joint's axis in the model; check the zeros, those of "
        "command and angle, too"
    )
    return Finding("warning", "gravity", share, MARGIN, message, remedy, joints[0] if len(joints) == 1 else None, row=0)


def _steady(log: MotorLog) -> _Steady:
    rows = _evenly(np.arange(log.num_rows), MOST_TRIED)
    bounds = np.array([(part.start, part.stop - 1) for part in log.segment_slices()])
    first, last = bounds[np.searchsorted(bounds[:, 0], rows, side="right") - 1].T
    half = max(1, round(0.5 * WINDOW / log.period))
    before, after = np.maximum(rows - half, first), np.minimum(rows + half, last)
    rows, before, after = rows[before < after], before[before < after], after[before < after]
    time = (log.time[after] - log.time[before])[:, None]
    speed, wanted = ((angle[after] - angle[before]) / time for angle in (log.joint_pos, log.position_target))
    moves = (np.abs(speed) > SLOWEST) & (np.abs(speed) < FASTEST) & (np.abs(speed - wanted) < STEADY)
    some = _evenly(np.flatnonzero(moves.any(axis=1)), MOST_ROWS)
    angle = log.joint_pos[rows[some]]
    return _Steady(angle, log.position_target[rows[some]] - angle, speed[some], moves[some])


def _evenly(rows: np.ndarray, most: int) -> np.ndarray:
    """No more than so many of some rows, from all over them."""
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]


def _left(steady: _Steady, gravity: Gravity, turned: tuple[int, ...]) -> float:
    """Mean square of the error that is left [rad²], over joints and their rows."""
    sign = np.ones(steady.angle.shape[1])
    sign[list(turned)] = -1.0
    torque = sign * gravity(sign * steady.angle)
    squares, count = 0.0, 0
    for column, rows in enumerate(steady.moves.T):
        if (number := int(rows.sum())) >= FEWEST_ROWS:
            squares += _squares_left(*(values[rows, column] for values in (torque, steady.error, steady.speed)))
            count += number
    return squares / count


def _squares_left(torque: np.ndarray, error: np.ndarray, speed: np.ndarray) -> float:
    """Sum of the squares that one joint's fit leaves [rad²]."""
    columns = np.stack([np.sign(speed), speed, -torque, np.ones_like(speed), error], axis=1)
    _, small = np.linalg.qr(columns)
    pull, one, left = small[2:, 2:].T  # the same sum, friction and lag taken out
    softness, offset = np.linalg.lstsq(np.stack([pull, one], axis=1), left, rcond=None)[0]
    if softness >= 0.0 and abs(offset) <= OFFSET:
        found = [(softness, offset)]
    else:  # a convex sum has its least on the bounds then
        found = [(max(_fitted(pull, left - bound * one), 0.0), bound) for bound in (-OFFSET, OFFSET)]
        found.append((0.0, np.clip(_fitted(one, left), -OFFSET, OFFSET)))
    return min(float(np.sum((left - softness * pull - offset * one) ** 2)) for softness, offset in found)


def _fitted(column: np.ndarray, values: np.ndarray) -> float:
    """Factor of a column that leaves the least of the values."""
    return float(column @ values / max(column @ column, np.finfo(float).tiny))
