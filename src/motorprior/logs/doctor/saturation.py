"""Checks for channels that stop while the command continues: end stops and limits, dead channels."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.excitation import excited_joints
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.doctor.jumps import MAX_LAG, encoder_step
from motorprior.logs.doctor.response import lag_rows
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog
from motorprior.signals import runs_of_true

TRAVEL = 0.1  # share of its range by which the command continues


def saturation(window: MotorLog) -> list[Finding]:
    """Angle, velocity or torque of a joint that stays at its extreme for 0.1 s while the command continues.

    Angle: see `_at_end_stop`. Velocity: the angle is behind its command by 0.25 s of that velocity. Torque: the command
    moves by 10 % of its range, and the torque has 20 or more values.
    """
    joint, late, found = window.joint_names[0], lag_rows(window), []
    if late is not None:
        late = min(late, int(0.1 / window.period))  # dead band and friction of slow motion cause longer lags
    min_rows = max(5, round(0.1 / window.period) + 1)  # reversals are shorter
    for sign in (1.0, -1.0):
        command, angle = sign * window.position_target[:, 0], sign * window.joint_pos[:, 0]
        extremes = {"joint_pos": (angle.max(), angle >= angle.max() - encoder_step(angle))}
        if window.joint_vel is not None and (top := (velocity := sign * window.joint_vel[:, 0]).max()) > 0.0:
            extremes["joint_vel"] = top, (velocity >= 0.98 * top) & (command - angle > MAX_LAG * top)
        if window.joint_torque is not None and len(np.unique(torque := sign * window.joint_torque[:, 0])) >= 20:
            extremes["joint_torque"] = torque.max(), torque >= torque.max() - 1e-9 * abs(torque.max())
        for channel, (top, at_top) in extremes.items():
            runs = [slice(*run) for run in runs_of_true(at_top).tolist() if run[0] and run[1] - run[0] >= min_rows]
            if channel == "joint_pos":
                runs = [run for run in runs if _at_end_stop(command, angle, run, late)]
            elif channel == "joint_torque":
                runs = [run for run in runs if np.ptp(command[run]) > TRAVEL * np.ptp(command)]
            if runs:
                time = window.period * sum(run.stop - run.start - 1 for run in runs)
                message = (
                    f"{channel}/{joint} stays at its extreme {sign * top:.4g} {JOINT_SERIES[channel]} for {time:.2f} s "
                    "in total while its command continues"
                )
                remedy = "keep it if the limit is to be identified; otherwise command less, or delete these rows"
                found.append(Finding("warning", "saturation", time, message, remedy, joint, runs[0].start))
    return found


def _at_end_stop(command: np.ndarray, angle: np.ndarray, run: slice, late: int | None) -> bool:
    """Whether the command continues beyond the highest angle, reached in ``run``, by 10 % of the command's range.

    Friction and dead band hold a joint after a reversal, too. So either the command is 2.5 times as far away as the RMS
    of other errors; or the command ``late`` rows before rises by 0.03 rad after the joint stopped.
    """
    top, travel, here = angle.max(), TRAVEL * np.ptp(command), command[run]
    error = (command - angle)[(angle < top - 1e-6) & (angle > angle.min() + 1e-6)]
    if here.max() - max(here.min(), top) <= travel:
        return False
    far = here.max() - top > 2.5 * np.sqrt(np.mean(error**2)) if error.size else True
    first = run.start - (late or 0)
    acting = command[max(0, first) : max(1, run.stop - (late or 0))]
    return bool(far or (late is not None and acting.max() - max(acting[0], top) > max(travel, 0.03)))


def dead(log: MotorLog) -> list[Finding]:
    """Channels that do not change for 0.5 s while the command moves by half of its range and 0.1 rad.

    The last 0.25 s do not count, as a servo responds late. A velocity is dead only while the angle moves. An angle or a
    torque at its extreme is saturated.
    """
    found = []
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
                if moved <= max(0.1, 0.5 * np.ptp(command)) or (not moving if channel == "joint_vel" else extreme):
                    continue
                message = f"{channel}/{joint} does not change for {times[place]:.2f} s from row {row} while its command"
                message += f" moves by {moved:.2g} rad"
                remedy = "check sensor, power and bus; record again, or delete these rows or the channel"
                found.append(Finding("warning", "dead", float(times[place]), message, remedy, joint, row))
                break
    return found
