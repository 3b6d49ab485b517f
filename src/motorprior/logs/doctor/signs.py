"""Checks of signs: joint_torque against motion or load, and joints against the gravity of the robot's model."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.response import MIN_REVERSALS, reversals
from motorprior.logs.loads import gravity_torque
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

# maximum, between angle and command [rad]; a larger one would absorb gravity that barely changes
MAX_OFFSET = 0.01
# reduction of the squared error; of 40 logs of a real arm with correct signs, the worst has 0.14
MIN_GAIN = 0.25
MIN_RMS = 2e-3  # of the error, and of its reduction [rad]
MIN_ROWS = 20  # of steady motion, and of a window with a known load
MAX_RATIO = 3.0  # of a torque over that of its load [-]; friction and armature explain less
_REVERSE = f"reverse it in the file, or {IN_MAP}: sign = -1 in [joints.….joint_torque]"


def torque_sign(window: MotorLog) -> Iterator[Finding]:
    """Torques that never change sign (|current|), or push away from the command and take work out of the joint.

    A torque that holds a weight keeps its sign, but does not come near 0.
    """
    if window.joint_torque is None or np.ptp(window.joint_torque) == 0.0:
        return
    torque = window.joint_torque[:, 0]
    angle = window.joint_pos[:, 0]
    joint = window.joint_names[0]
    low, high = np.percentile(np.abs(torque), [5, 95])
    both_ways = reversals(angle) >= MIN_REVERSALS
    if torque.min() * torque.max() >= 0.0 and low <= 0.1 * high and both_ways:
        message = f"joint_torque/{joint} never changes sign while the joint moves back and forth"
        remedy = f"it is the magnitude of a current: leave it out of the file, or {IN_MAP}"
        yield Finding("warning", "unsigned_torque", float(low), message, remedy, joint)
        return
    if window.load_inertia is not None and window.external_torque is not None:
        yield from _against_load(window)
        return
    error = window.position_target[:, 0] - angle
    work = 0.5 * (torque[1:] + torque[:-1]) * np.diff(angle)
    share = float(work.sum() / max(np.abs(work).sum(), 1e-300))
    correlation = float(np.corrcoef(torque, error)[0, 1]) if np.ptp(error) > 0.0 else 0.0
    if correlation >= -0.5 and (share >= -0.3 or correlation > 0.0):
        return
    message = f"joint_torque/{joint} pushes away from the command: correlation {correlation:.2f} with the position "
    message += f"error, {share:+.2f} of the work goes into the joint"
    yield Finding("warning", "torque_sign", correlation, message, _REVERSE, joint)


def _against_load(window: MotorLog) -> Iterator[Finding]:
    """A torque that opposes that of the known load, J·q̈ - external torque, or has another scale."""
    assert (
        window.joint_torque is not None
        and window.load_inertia is not None
        and window.external_torque is not None
    )
    half = max(1, round(0.02 / window.period))
    if window.num_rows < MIN_ROWS + 2 * half:
        return
    angle = window.joint_pos[:, 0]
    rows = slice(half, -half)
    joint = window.joint_names[0]
    acceleration = (angle[2 * half :] - 2.0 * angle[rows] + angle[: -2 * half]) / (
        half * window.period
    ) ** 2
    load = window.load_inertia[rows, 0] * acceleration - window.external_torque[rows, 0]
    torque = window.joint_torque[rows, 0]
    correlation = float(np.corrcoef(torque, load)[0, 1]) if np.ptp(load) > 0.0 else 0.0
    ratio = float(np.std(torque) / max(np.std(load), 1e-300))
    message = f"joint_torque/{joint} has a correlation of {correlation:.2f} with the torque of its known load, and "
    message += f"{ratio:.2g} times its standard deviation"
    if correlation < -0.5:
        yield Finding("warning", "torque_sign", correlation, message, _REVERSE, joint)
    elif correlation > 0.8 and not 1.0 / MAX_RATIO <= ratio <= MAX_RATIO:
        remedy = (
            f"convert it to N·m at the joint in the file, or {IN_MAP} by scale; or correct the load"
        )
        yield Finding("warning", "torque_scale", ratio, message, remedy, joint)


def gravity_signs(log: MotorLog, robot: Robot) -> Iterator[Finding]:
    """One or two joints that seem reversed: gravity then explains the errors of steady motion better.

    A position-controlled motor in slow, steady motion deflects by its torque over kp. Per joint,

        position_target - joint_pos = -gravity/kp + friction·sign(speed) + lag·speed + offset,    kp >= 0

    is fitted for signs as given, and with one or two joints reversed. Gravity does not act about
    vertical axes. Nothing is found unless the base was fixed or suspended (`loads.gravity_torque`).
    """
    angle, error, speed, steady = _steady_motion(log)
    gravity = gravity_torque(log, robot)
    if gravity is None or steady.sum(axis=0).max(initial=0) < MIN_ROWS:
        return

    def residual(*joints: int) -> float:
        sign = np.where(np.isin(np.arange(log.num_joints), joints), -1.0, 1.0)
        return _residual(sign * gravity(sign * angle), error, speed, steady)

    given = residual()
    if given < MIN_RMS**2:
        return
    some = [joints for count in (1, 2) for joints in combinations(range(log.num_joints), count)]
    squares = {joints: residual(*joints) for joints in some}
    enough = min(squares.values()) + 0.05 * max(0.0, given - min(squares.values()))
    # one, or two
    joints, best = next((joints, square) for joints, square in squares.items() if square <= enough)
    before, after = np.sqrt([given, best])
    if best > (1.0 - MIN_GAIN) * given or before - after < MIN_RMS:
        return
    named = " and ".join(log.joint_names[column] for column in joints)
    message = f"gravity of the robot's model leaves {1e3 * before:.1f} mrad of the errors of steady motion unexplained,"
    message += f" and {1e3 * after:.1f} mrad with {named} reversed"
    remedy = f"check the base's orientation, and order, axes, signs and zeros of {named}; correct them in the file, "
    remedy += f"{IN_MAP} by names, sign and zero, or in the model"
    joint = named if len(joints) == 1 else None
    yield Finding("warning", "gravity", 1.0 - best / given, message, remedy, joint)


def _steady_motion(log: MotorLog) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(N, J) angle [rad], error [rad], speed [rad/s] in up to 500 rows of steady motion, and which joints move."""
    half = max(1, round(0.1 / log.period))
    rows = np.concatenate(
        [np.arange(part.start + half, part.stop - half) for part in log.segment_slices()]
    ).astype(int)
    rows = rows[:: max(1, len(rows) // 20_000)]
    time = (log.time[rows + half] - log.time[rows - half])[:, None]
    speed, commanded = (
        (x[rows + half] - x[rows - half]) / time for x in (log.joint_pos, log.position_target)
    )
    # [rad/s]; static friction may act either way
    moves = (np.abs(speed) > 0.03) & (np.abs(speed) < 0.5)
    steady = moves & (np.abs(speed - commanded) < 0.05)
    some = np.flatnonzero(steady.any(axis=1))
    some = some[np.linspace(0, len(some) - 1, min(len(some), 500)).astype(int)]
    angle = log.joint_pos[rows[some]]
    return angle, log.position_target[rows[some]] - angle, speed[some], steady[some]


def _residual(
    torque: np.ndarray, error: np.ndarray, speed: np.ndarray, steady: np.ndarray
) -> float:
    """Mean square of the errors [rad²] that the fit leaves, over joints and their steady rows."""
    from scipy.optimize import lsq_linear  # takes half a second

    squares = 0.0
    count = 0
    for column in np.flatnonzero(steady.sum(axis=0) >= MIN_ROWS):
        rows = steady[:, column]
        e = error[rows, column]
        v = speed[rows, column]
        pull = -torque[rows, column]
        kept = np.abs(e) <= np.percentile(np.abs(e), 98)  # the largest are transients
        terms = np.stack([pull, np.ones(len(e)), np.sign(v), v], axis=1)[kept]
        bounds = [0.0, -MAX_OFFSET, -np.inf, -np.inf], [np.inf, MAX_OFFSET, np.inf, np.inf]
        squares += 2.0 * float(lsq_linear(terms, e[kept], bounds, method="bvls").cost)
        count += int(kept.sum())
    return squares / count
