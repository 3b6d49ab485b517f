"""Which joints were commanded to move and did; checks of how they were excited, and of dead channels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.readings import MAX_LAG
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.operations import EXCITED_STD, excited_joints, gap_rows, repeated_rows, resample

RATIOS = (0.1, 3.0)  # of the motion to its command; otherwise the motion failed, or has another unit
MIN_REVERSALS = 4
MIN_ROWS, MAX_ROWS = 20, 20_000  # of a window


def excited_window(log: MotorLog, column: int) -> tuple[slice, MotorLog] | None:
    """The window without gaps in which the command of a joint travels farthest, of 20 000 rows at most.

    Returns its rows, and that joint alone on a uniform grid with the period of new readings; None if the command moves
    in no window of 20 new readings.
    """
    best, found, repeated, command = 0.0, None, repeated_rows(log), log.position_target[:, column]
    starts = {part.start for part in log.segment_slices()} | set(gap_rows(log).tolist())
    for part in np.split(np.arange(log.num_rows), sorted(starts - {0})):
        for rows in np.split(part, range(MAX_ROWS, len(part), MAX_ROWS)):
            travel = float(np.abs(np.diff(command[rows])).sum())
            moves = np.std(command[rows]) > EXCITED_STD
            if moves and travel > best and np.sum(~repeated[rows]) > MIN_ROWS:
                best, found = travel, slice(int(rows[0]), int(rows[-1]) + 1)
    if found is None:
        return None
    period = np.median(time_steps(log.rows(found).rows(~repeated[found]))[1])
    return found, resample(log.joint(column).rows(found), float(period))


def excitation(log: MotorLog) -> Iterator[Finding]:
    """Joints that are not commanded, move far less or more than commanded, or reverse rarely."""
    excited = excited_joints(log)
    if not excited.size:
        yield Finding("error", "excitation", 0.0, "no joint is excited", "record commands that move")
    for column, joint in enumerate(log.joint_names):
        command, angle = log.position_target[:, column], log.joint_pos[:, column]
        ratio = float(np.std(angle) / max(np.std(command), 1e-12))
        if column not in excited:
            message = f"{joint} is not excited: standard deviation of its command {1e3 * np.std(command):.3f} mrad"
            yield Finding("info", "excitation", float(np.std(command)), message, joint=joint)
            continue
        if not RATIOS[0] <= ratio <= RATIOS[1]:
            message = f"{joint} moves {ratio:.3g} times its command, outside {RATIOS[0]:g} to {RATIOS[1]:g}"
            remedy = "check power, homing, joint order and units; if command and angle have different units, state one "
            remedy += f'{IN_MAP}: angle = "deg" in [joints.….position_target] or [joints.….joint_pos]'
            yield Finding("warning", "excitation", ratio, message, remedy, joint)
        count = sum(reversals(angle[part], 0.05 * float(np.ptp(angle))) for part in log.segment_slices())
        if count < MIN_REVERSALS:
            message = f"{joint}: {count} reversals, fewer than {MIN_REVERSALS}: friction and backlash need reversals"
            yield Finding("warning", "reversals", count, message, "record motions back and forth", joint)


def reversals(angle: np.ndarray, threshold: float) -> int:
    """Number of reversals of an angle (T,) that exceed ``threshold`` [rad]."""
    count, direction, extreme = -1, 0.0, float(angle[0])
    for value in angle[:: max(1, len(angle) // 200_000)].tolist():
        if direction and direction * (value - extreme) >= 0.0:
            extreme = value
        elif abs(value - extreme) > threshold:
            count, direction, extreme = count + 1, value - extreme, value
    return max(count, 0)


def dead(log: MotorLog) -> Iterator[Finding]:
    """Channels that do not change for 0.5 s while the command moves by half of its range and 0.1 rad.

    The last 0.25 s do not count, as a servo responds late. A velocity is dead only while the angle moves. An angle or a
    torque at its extreme is saturated.
    """
    for column in excited_joints(log):
        joint, command, angle = log.joint_names[column], log.position_target[:, column], log.joint_pos[:, column]
        for channel in ("joint_pos", "joint_vel", "joint_torque"):
            if (values := getattr(log, channel)) is None:
                continue
            values = values[:, column]
            changed = np.diff(values, prepend=np.nan) != 0.0
            changed[[part.start for part in log.segment_slices()]] = True
            starts = np.flatnonzero(changed)
            lasts = np.append(starts[1:], log.num_rows) - 1
            times = log.time[lasts] - log.time[starts]
            for place in np.flatnonzero(times >= 0.5).tolist():
                row, last = int(starts[place]), int(lasts[place])
                moved = np.ptp(command[row : max(row + 1, last + 1 - round(MAX_LAG / log.period))])
                extreme = values[row] in (values.min(), values.max()) and np.ptp(values) > 0.0
                moving = np.ptp(angle[row : last + 1]) > 0.05 * np.ptp(angle)
                if moved > max(0.1, 0.5 * np.ptp(command)) and (moving if channel == "joint_vel" else not extreme):
                    message = f"{channel}/{joint} does not change for {times[place]:.2f} s from row {row} while its "
                    message += f"command moves by {moved:.2g} rad"
                    remedy = "check sensor, power and bus; record again, or delete these rows or the channel"
                    yield Finding("warning", "dead", float(times[place]), message, remedy, joint, row)
                    break
