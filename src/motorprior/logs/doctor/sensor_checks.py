"""Checks of what sensors can resolve and sign: encoder steps, torques without a sign or with the other one."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.excited_stretch import MAX_SAMPLES, Stretch
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.doctor.reversals import reversals
from motorprior.logs.motor_log import MotorLog

SMALLEST_STEP = 1e-6
"""Differences below this are rounding [rad]."""
COARSE = 0.05
"""A step larger than this share of the motion's standard deviation is coarse."""
MIN_REVERSALS = 4
NEAR_ZERO = 0.1
"""A rectified torque comes down to this share of its 95th percentile; one that holds a weight does not."""
OTHER_SIGN = -0.5
TAKEN = -0.3
"""Share of the work that a motor takes out of a joint."""


def encoder_step(angle: np.ndarray) -> float:
    """Smallest difference [rad] of two different readings (T,), at least 1e-6; of a long log, of evenly spaced rows."""
    levels = np.unique(angle[:: max(1, len(angle) // MAX_SAMPLES)])
    steps = np.diff(levels)
    return float(np.min(steps[steps > SMALLEST_STEP], initial=np.inf)) if np.any(steps > SMALLEST_STEP) else 0.0


def quantisation(log: MotorLog) -> list[Finding]:
    """Encoder steps of more than 5 % of the motion's standard deviation."""
    found = []
    for column in excited_joints(log):
        angle, joint = log.joint_pos[:, column], log.joint_names[column]
        spread, step = float(np.std(angle)), encoder_step(angle)
        if spread == 0.0 or step <= COARSE * spread:
            continue
        row = int(np.argmax(angle != angle[0]))
        message = (
            f"{joint} is read in steps of {1e3 * step:.3g} mrad, {100 * step / spread:.0f} % of the standard "
            f"deviation of its motion (bound {100 * COARSE:g} %)"
        )
        remedy = "command larger motions, and trust no derivative of this angle"
        found.append(Finding("warning", "quantisation", step, COARSE * spread, message, remedy, joint, row))
    return found


def torque_without_sign(log: MotorLog) -> list[Finding]:
    """Torques that never change sign, come down to zero, and belong to angles that go both ways: |current|."""
    if log.joint_torque is None:
        return []
    found = []
    for column, joint in enumerate(log.joint_names):
        torque, angle = log.joint_torque[:, column], log.joint_pos[:, column]
        if torque.min() < 0.0 < torque.max() or np.ptp(torque) == 0.0:
            continue
        low, high = np.percentile(np.abs(torque), [5, 95])
        turns = reversals(angle[:: max(1, len(angle) // MAX_SAMPLES)])
        if low > NEAR_ZERO * high or len(turns) < MIN_REVERSALS:
            continue
        least = float(np.min(np.abs(torque)))
        message = f"joint_torque/{joint} never changes sign (least size {least:.3g} N·m) while the joint goes both ways"
        remedy = "it is the size of a current: leave it out of the file, or joint_torque out of its column map"
        row = int(np.argmax(torque != 0.0))
        found.append(Finding("warning", "unsigned_torque", least, 0.0, message, remedy, joint, row))
    return found


def torque_sign(stretch: Stretch) -> list[Finding]:
    """Torques that push away from the command, or take work out of a joint that nothing else drives.

    A motor that holds a position pushes towards it, and one that moves a joint pays for its friction, so that neither
    the correlation of torque and position error nor the share of the work, ∫τ·dq / ∫|τ·dq|, is clearly negative. Where
    the load is known, `torque_checks.torque_and_load` says it better.
    """
    torque, error, joint = stretch.torque, stretch.command - stretch.angle, stretch.joint
    if torque is None or np.std(torque) == 0.0 or np.std(error) == 0.0:
        return []
    work = 0.5 * (torque[1:] + torque[:-1]) * np.diff(stretch.angle)
    paid = float(work.sum() / max(np.abs(work).sum(), np.finfo(float).tiny))
    correlation = float(np.corrcoef(torque, error)[0, 1])
    described = f"correlation {correlation:.2f} with the error, {paid:+.2f} of the work goes into the joint"
    if correlation >= OTHER_SIGN and (paid >= TAKEN or correlation > 0.0):
        return []
    message = f"joint_torque/{joint} pushes away from the command: {described}"
    remedy = f"turn it in the file, or {IN_MAP}: sign = -1 in the table [joints.….joint_torque]"
    return [Finding("warning", "torque_sign", correlation, OTHER_SIGN, message, remedy, joint, stretch.row)]
