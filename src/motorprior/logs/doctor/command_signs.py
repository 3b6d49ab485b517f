"""Checks of sign and unit of velocity targets and commanded torques.

A velocity target is compared with the motion that it commands, a commanded torque with the
acceleration that it causes. A window is one joint on a uniform grid.
"""

from collections.abc import Iterator

import numpy as np

from motorprior.logs.command_modes import commands_angles
from motorprior.logs.doctor.commands import (
    ACCELERATION_TIME,
    FULL_FRICTION_SPEED,
    commands_of,
    explained_by,
)
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import PHYSICAL_GAINS, MotorLog

SPAN = 0.1  # over which displacements are compared [s]
MIN_ROWS = 20  # minimum number of displacements
MIN_CORRELATION = 0.8  # minimum size of a correlation that gives the scale of a velocity target
# plausible velocity targets over the rate of the position target, and over the velocity of a joint
TARGET_RATIOS = (0.5, 2.0)
MOTION_RATIOS = (0.3, 3.0)
COPY_CORRELATION = 0.9998  # correlation above which a velocity target is the measured velocity
TORQUE_RATIOS = (0.5, 2.0)  # plausible effect of a torque over its logged size
MIN_WIDTHS = 30  # minimum length of a window over the time that smooths accelerations
MIN_GAIN = 1.3  # minimum ratio of the unexplained variance without and with a torque


def velocity_target(window: MotorLog) -> Iterator[Finding]:
    """Velocity targets of another sign or unit than the motion that they command.

    Their integrals over 0.1 s are compared with changes of the position target, or of the angle in
    velocity mode.
    """
    if window.velocity_target is None or not np.any(window.velocity_target):
        return
    has_angles = bool(commands_angles(window)[0])
    motion = window.position_target[:, 0] if has_angles else window.joint_pos[:, 0]
    width = max(1, round(SPAN / window.period))
    area = np.append(0.0, np.cumsum(window.velocity_target[:-1, 0])) * window.period
    integral = area[width:] - area[:-width]
    change = motion[width:] - motion[:-width]
    if len(change) < MIN_ROWS:
        return
    # steps of a position target have no velocity
    counts = np.abs(change) <= 3.0 * np.median(np.abs(change)) + 1e-9
    integral = integral[counts]
    change = change[counts]
    norm = np.sqrt((integral @ integral) * (change @ change))
    correlation = float(change @ integral / max(norm, 1e-300))
    ratio = float(np.sqrt((integral @ integral) / max(change @ change, 1e-300)))

    joint = window.joint_names[0]
    moved = "the change of position_target" if has_angles else "the motion of the joint"
    text = (
        f"velocity_target/{joint} is {np.copysign(ratio, correlation):.3g} times {moved} "
        f"(correlation {correlation:.2f})"
    )
    if abs(correlation) < (MIN_CORRELATION if has_angles else 0.5 * MIN_CORRELATION):
        return
    if correlation < 0.0:
        remedy = f"reverse it {IN_MAP}: sign = -1 in [joints.….velocity_target]"
        yield Finding("warning", "velocity_target", correlation, text, remedy, joint)
        return
    low, high = TARGET_RATIOS if has_angles else MOTION_RATIOS
    if not low <= ratio <= high:
        remedy = f'state its unit {IN_MAP}: velocity = "deg/s", "turn/s" or "rpm"'
        yield Finding("warning", "velocity_target", ratio, text, remedy, joint)
    elif not has_angles and correlation > COPY_CORRELATION:
        remedy = "it is the measured velocity: log the commanded one"
        yield Finding("warning", "velocity_target", correlation, text, remedy, joint)


def commanded_torque(window: MotorLog) -> Iterator[Finding]:
    """Commanded torques whose effect has another sign or size than theirs.

    With known loads and gains, the factor is that of the torque balance (`_factor_by_load`). Else
    it is the acceleration per torque over that per kp times position target, by the regression of
    `commands.command_rate`. Without a position target, the regression gives the sign only.
    """
    if window.torque_feedforward is None:
        return
    factor = _factor_by_load(window)
    basis = "the known load"
    if factor is None:
        factor = _factor_by_acceleration(window)
        basis = "the acceleration"
    if factor is None:
        return

    joint = window.joint_names[0]
    low, high = TORQUE_RATIOS
    if factor < 0.0:
        message = f"torque_feedforward/{joint} acts against its sign, by {basis}"
        remedy = f"reverse it {IN_MAP}: sign = -1 in [joints.….torque_feedforward]"
        yield Finding("warning", "commanded_torque", factor, message, remedy, joint)
    elif not low <= factor <= high:
        message = f"torque_feedforward/{joint} acts {factor:.3g} times as strongly, by {basis}"
        remedy = (
            f"convert it to N·m at the joint {IN_MAP}: torque or scale in "
            "[joints.….torque_feedforward]"
        )
        yield Finding("warning", "commanded_torque", factor, message, remedy, joint)


def _factor_by_load(window: MotorLog) -> float | None:
    """Factor k of the commanded torque in the torque balance of a joint with a known load.

        J·q̈ - external torque - kp·error - kd·velocity error = k·torque - I·q̈ - f·sign q̇ - d·q̇ + c

    None without loads or gains in N·m/rad, if the window is short, or if the torque explains
    little.
    """
    if window.load_inertia is None or window.external_torque is None:
        return None
    assert window.torque_feedforward is not None
    has_gains = window.logged_kp is not None and window.gain_unit == PHYSICAL_GAINS
    if window.command_mode != "torque" and not has_gains:
        return None

    half_width = max(1, round(ACCELERATION_TIME / window.period))
    if window.num_rows < MIN_WIDTHS * half_width:
        return None
    angle = window.joint_pos[:, 0]
    velocity = np.gradient(angle, window.period)
    acceleration = np.gradient(velocity, window.period)
    sent = window.torque_feedforward[:, 0]
    known = window.load_inertia[:, 0] * acceleration - window.external_torque[:, 0]
    if window.logged_kp is not None:
        known -= window.logged_kp[:, 0] * (window.position_target[:, 0] - angle)
    if window.logged_kd is not None:
        target = 0.0 if window.velocity_target is None else window.velocity_target[:, 0]
        known -= window.logged_kd[:, 0] * (target - velocity)

    friction = np.tanh(velocity / FULL_FRICTION_SPEED)
    terms = [sent, acceleration, friction, velocity, np.ones_like(angle)]
    smooth = np.ones(2 * half_width + 1) / (2 * half_width + 1)
    inside = slice(4 * half_width, -4 * half_width)
    table = np.stack([np.convolve(term, smooth, "same")[inside] for term in terms], axis=1)
    balance = np.convolve(known, smooth, "same")[inside]

    with_torque, unexplained = _fitted(table, balance)
    _, unexplained_without = _fitted(table[:, 1:], balance)
    return float(with_torque[0]) if unexplained_without >= MIN_GAIN * unexplained else None


def _fitted(table: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients of the columns by least squares, and the variance that they leave."""
    coefficients = np.linalg.lstsq(table, values, rcond=None)[0]
    return coefficients, float(np.var(values - table @ coefficients))


def _factor_by_acceleration(window: MotorLog) -> float | None:
    """Factor of the commanded torque relative to kp times the error; 1 or -1 without kp.

    None if the window is short, or if the torque explains little of the acceleration.
    """
    names, commands = commands_of(window)
    if "torque_feedforward" not in names:
        return None
    half_width = max(1, round(ACCELERATION_TIME / window.period))
    if window.num_rows < MIN_WIDTHS * half_width:
        return None
    place = names.index("torque_feedforward")
    unexplained, slopes = explained_by(window, commands, half_width)
    without, _ = explained_by(window, np.delete(commands, place, axis=1), half_width)
    if without < MIN_GAIN * unexplained:
        return None

    slope = float(slopes[place])
    if "position_target" not in names or window.logged_kp is None or slope < 0.0:
        return float(np.sign(slope))
    position_slope = float(slopes[names.index("position_target")])
    # the regression gives no scale if the position target seems to act against its sign
    if window.gain_unit != PHYSICAL_GAINS or position_slope <= 0.0:
        return 1.0
    return slope * float(window.logged_kp.max()) / position_slope
