"""Checks of signs: joint_torque against motion or load, and joints against modelled gravity."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.response import MIN_REVERSALS, reversals
from motorprior.logs.loads import gravity_torque
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.torque_column import MIN_EXPLAINED, torque_column
from motorprior.robots.robot import Robot

# maximum fitted offset between angle and command [rad]; a larger offset would absorb the effect of
# gravity where it barely changes
MAX_OFFSET = 0.01
# Minimum relative reduction of the squared error by reversing joints. Among 40 logs of a real arm
# with correct signs, the largest reduction is 0.14.
MIN_REDUCTION = 0.25
MIN_RMS = 2e-3  # minimum root-mean-square error, and minimum of its reduction [rad]
MIN_ROWS = 20  # minimum rows of steady motion, and of a window with a known load
MAX_FACTOR = 1.2  # of joint_torque on the torque of the load, either way [-]
_REVERSE = f"reverse it in the file, or {IN_MAP}: sign = -1 in [joints.….joint_torque]"


def torque_sign(window: MotorLog) -> Iterator[Finding]:
    """Torques that never change sign, or oppose the command or their load.

    A torque that comes near 0 and never changes sign is a magnitude. (The torque of a joint that
    holds a weight keeps its sign, too, but does not come near 0.) A torque opposes the command if
    it pushes away from the command and takes work out of the joint.
    """
    if window.joint_torque is None or np.ptp(window.joint_torque) == 0.0:
        return
    torque = window.joint_torque[:, 0]
    angle = window.joint_pos[:, 0]
    joint = window.joint_names[0]

    low, high = np.percentile(np.abs(torque), [5, 95])
    comes_near_zero = low <= 0.1 * high
    keeps_sign = torque.min() * torque.max() >= 0.0
    if keeps_sign and comes_near_zero and reversals(angle) >= MIN_REVERSALS:
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
    opposes_command = correlation < -0.5 or (share < -0.3 and correlation <= 0.0)
    if opposes_command:
        message = (
            f"joint_torque/{joint} pushes away from the command: correlation {correlation:.2f} "
            f"with the position error, {share:+.2f} of the work goes into the joint"
        )
        yield Finding("warning", "torque_sign", correlation, message, _REVERSE, joint)


def _against_load(window: MotorLog) -> Iterator[Finding]:
    """Findings if joint_torque opposes the torque of the known load, or has another scale.

    The torque of the load is J·q̈ - external torque, with the load inertia J.
    """
    assert window.joint_torque is not None
    assert window.load_inertia is not None
    assert window.external_torque is not None
    half = max(1, round(0.02 / window.period))
    if window.num_rows < MIN_ROWS + 2 * half:
        return

    joint = window.joint_names[0]
    rows = slice(half, -half)
    angle = window.joint_pos[:, 0]
    curvature = angle[2 * half :] - 2.0 * angle[rows] + angle[: -2 * half]
    acceleration = curvature / (half * window.period) ** 2
    load = window.load_inertia[rows, 0] * acceleration - window.external_torque[rows, 0]
    torque = window.joint_torque[rows, 0]

    correlation = float(np.corrcoef(torque, load)[0, 1]) if np.ptp(load) > 0.0 else 0.0
    if correlation < -0.5:
        message = (
            f"joint_torque/{joint} has a correlation of {correlation:.2f} with the torque of its "
            "known load"
        )
        yield Finding("warning", "torque_sign", correlation, message, _REVERSE, joint)
        return

    column = torque_column(window, 0)
    if column is None or column.explained < MIN_EXPLAINED:
        return
    if not 1.0 / MAX_FACTOR <= column.factor <= MAX_FACTOR:
        message = f"joint_torque/{joint} is {column}, by the known load"
        remedy = (
            f"convert it to N·m at the joint in the file, or {IN_MAP}: "
            f"scale = {1.0 / column.factor:.3g} in [joints.….joint_torque]; or correct the load"
        )
        yield Finding("warning", "torque_scale", column.factor, message, remedy, joint)


@dataclass(frozen=True)
class _SteadyMotion:
    """Rows of slow, steady motion; arrays are (N, J)."""

    angle: np.ndarray  # [rad]
    error: np.ndarray  # position_target - joint_pos [rad]
    speed: np.ndarray  # [rad/s]
    is_steady: np.ndarray  # which joints move steadily


def gravity_signs(log: MotorLog, robot: Robot) -> Iterator[Finding]:
    """One or two joints that seem reversed: gravity then explains the errors of steady motion.

    A position-controlled motor in slow, steady motion deflects by its torque over kp. Per joint,

        position_target - joint_pos = -gravity/kp + friction·sign(speed) + lag·speed + offset

    with kp >= 0 is fitted for signs as given, and with one or two joints reversed. Gravity does not
    act about vertical axes. There is no finding unless the base was fixed or suspended
    (`loads.gravity_torque`).
    """
    motion = _steady_motion(log)
    gravity = gravity_torque(log, robot)
    if gravity is None or motion.is_steady.sum(axis=0).max(initial=0) < MIN_ROWS:
        return

    def residual(*joints: int) -> float:
        """Mean square [rad²] of the residual errors of the fit with these joints reversed."""
        sign = np.where(np.isin(np.arange(log.num_joints), joints), -1.0, 1.0)
        return _residual(sign * gravity(sign * motion.angle), motion)

    as_given = residual()
    if as_given < MIN_RMS**2:
        return
    joints, reversed_residual = _best_reversal(residual, as_given, log.num_joints)
    rms_before, rms_after = np.sqrt([as_given, reversed_residual])
    is_reduced = reversed_residual <= (1.0 - MIN_REDUCTION) * as_given
    if not is_reduced or rms_before - rms_after < MIN_RMS:
        return

    names = " and ".join(log.joint_names[column] for column in joints)
    message = (
        f"gravity of the robot's model leaves {1e3 * rms_before:.1f} mrad of the errors of steady "
        f"motion unexplained, and {1e3 * rms_after:.1f} mrad with {names} reversed"
    )
    remedy = (
        f"check the base's orientation, and order, axes, signs and zeros of {names}; correct them "
        f"in the file, {IN_MAP} by names, sign and zero, or in the model"
    )
    joint = names if len(joints) == 1 else None
    reduction = 1.0 - reversed_residual / as_given
    yield Finding("warning", "gravity", reduction, message, remedy, joint)


def _best_reversal(
    residual: Callable[..., float], as_given: float, num_joints: int
) -> tuple[tuple[int, ...], float]:
    """The joint, or else the two joints, to reverse, and the residual then.

    The reversal leaves the smallest residual, within 5 % of the improvement on ``as_given``; among
    such reversals, a single joint comes first.
    """
    columns = range(num_joints)
    reversals_to_try = [*combinations(columns, 1), *combinations(columns, 2)]
    residuals = {joints: residual(*joints) for joints in reversals_to_try}
    smallest = min(residuals.values())
    bound = smallest + 0.05 * max(0.0, as_given - smallest)
    return next((joints, value) for joints, value in residuals.items() if value <= bound)


def _steady_motion(log: MotorLog) -> _SteadyMotion:
    """Up to 500 rows of steady motion."""
    half = max(1, round(0.1 / log.period))
    rows = np.concatenate(
        [np.arange(rows.start + half, rows.stop - half) for rows in log.segment_slices()]
    ).astype(int)
    rows = rows[:: max(1, len(rows) // 20_000)]

    time = (log.time[rows + half] - log.time[rows - half])[:, None]
    speed = (log.joint_pos[rows + half] - log.joint_pos[rows - half]) / time
    target_change = log.position_target[rows + half] - log.position_target[rows - half]
    commanded_speed = target_change / time

    # Rows below 0.03 rad/s do not count: static friction may act either way.
    moves = (np.abs(speed) > 0.03) & (np.abs(speed) < 0.5)
    is_steady = moves & (np.abs(speed - commanded_speed) < 0.05)

    selected = np.flatnonzero(is_steady.any(axis=1))
    places = np.linspace(0, len(selected) - 1, min(len(selected), 500)).astype(int)
    selected = selected[places]
    angle = log.joint_pos[rows[selected]]
    error = log.position_target[rows[selected]] - angle
    return _SteadyMotion(angle, error, speed[selected], is_steady[selected])


def _residual(gravity: np.ndarray, motion: _SteadyMotion) -> float:
    """Mean square of the fit's residuals, over all joints' rows of steady motion [rad²]."""
    from scipy.optimize import lsq_linear  # takes half a second

    squares = 0.0
    count = 0
    for column in np.flatnonzero(motion.is_steady.sum(axis=0) >= MIN_ROWS):
        rows = motion.is_steady[:, column]
        error = motion.error[rows, column]
        speed = motion.speed[rows, column]
        pull = -gravity[rows, column]

        usual = np.abs(error) <= np.percentile(np.abs(error), 98)  # the largest are transients
        terms = np.stack([pull, np.ones(len(error)), np.sign(speed), speed], axis=1)[usual]
        lower = [0.0, -MAX_OFFSET, -np.inf, -np.inf]
        upper = [np.inf, MAX_OFFSET, np.inf, np.inf]
        fit = lsq_linear(terms, error[usual], (lower, upper), method="bvls")
        squares += 2.0 * float(fit.cost)
        count += int(usual.sum())
    return squares / count
