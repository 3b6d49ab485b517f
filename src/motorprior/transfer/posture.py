"""Posture of a logged robot, if the log does not state it: by tilt, and by replaying both postures."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.robots.robot import Robot
from motorprior.signals import runs_of_true
from motorprior.transfer.log_replay import Replayer

FALLEN_TILT = 0.8  # [rad] roll or pitch of a fallen robot
FALLEN_TIME = 0.2  # [s] minimum duration of this tilt
MARGIN = 0.7  # a log counts as suspended if that error is below this share of the error standing


class Posture(NamedTuple):
    """Attributes: name, one of `motor_log.POSTURES`; evidence, for the user."""

    name: str
    evidence: str


def with_posture(log: MotorLog, name: str) -> MotorLog:
    """The log with one posture; rows of a standing robot with the tilt of a fall are fallen."""
    codes = np.full(log.num_rows, POSTURES.index(name))
    if log.base_orientation is not None and name == "standing":
        for segment in log.segment_slices():
            time, tilt = log.time[segment], np.abs(log.base_orientation[segment]).max(axis=1)
            for first, after in runs_of_true(tilt > FALLEN_TILT):
                if time[after - 1] - time[first] >= FALLEN_TIME:
                    codes[segment][first:after] = POSTURES.index("fallen")
    return replace(log, posture=codes)


def find_posture(log: MotorLog, prepared: MotorLog, robot: Robot, actuator: Actuator) -> Posture:
    """The logged posture; else the one with the lower replay error on these motors, by a margin, or standing.

    Args:
        log: all rows.
        prepared: see `log_replay.prepare`.
        robot: of the log.
        actuator: motors similar to the robot's.
    """
    if log.posture is not None:
        names = [POSTURES[code] for code in np.unique(log.posture)]
        return Posture(names[0], f"{' and '.join(names)}, as logged")
    if robot.base == "fixed":
        return Posture("fixed", "fixed base")
    standing, suspended = (
        Replayer(with_posture(log, name), robot, with_posture(prepared, name)) for name in ("standing", "suspended")
    )
    suspended.compared = standing.compared  # the same rows, up to a fall
    on_feet, in_air = (float(np.nanmean(each.run(actuator).rmse)) for each in (standing, suspended))
    name = "suspended" if in_air < MARGIN * on_feet else "standing"
    errors = f"{1e3 * on_feet:.1f} mrad standing, {1e3 * in_air:.1f} mrad suspended"
    return Posture(name, f"{name}, from replay errors: {errors}")
