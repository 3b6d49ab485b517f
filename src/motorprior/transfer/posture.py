"""How a robot was held while a log was recorded, where the log does not say: by tilt, and by replaying both ways."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.robots.robot import Robot
from motorprior.signals import runs_of_true
from motorprior.transfer.real_replay import Replayer

FALLEN_TILT = 0.8
"""Roll or pitch beyond which a robot has fallen [rad]."""
FALLEN_TIME = 0.2
"""Time for which it must stay so [s]: a single reading may be wrong."""
MARGIN = 0.7
"""A log counts as hung only if its error hung is below this share of its error standing."""


@dataclass(frozen=True)
class Posture:
    """What a log's posture is taken to be, and why.

    Attributes:
        name: one of `motor_log.POSTURES`.
        evidence: for the reader of a report.
    """

    name: str
    evidence: str


def with_posture(log: MotorLog, name: str) -> MotorLog:
    """The same log, in one posture but for rows whose tilt says that the robot has fallen."""
    codes = np.full(log.num_rows, POSTURES.index(name))
    if log.base_orientation is not None and name == "standing":
        for part in log.segment_slices():
            codes[part][_lying(log.time[part], log.base_orientation[part])] = POSTURES.index("fallen")
    return replace(log, posture=codes)


def _lying(time: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """(rows,) whether a row is one of a stretch of FALLEN_TIME or more beyond FALLEN_TILT."""
    tilted = np.abs(tilt).max(axis=1) > FALLEN_TILT
    for first, after in runs_of_true(tilted):
        tilted[first:after] = time[after - 1] - time[first] >= FALLEN_TIME
    return tilted


def find_posture(log: MotorLog, prepared: MotorLog, robot: Robot, actuator: Actuator) -> Posture:
    """What the log states; else the posture in which these motors replay it better, standing if none clearly does.

    Args:
        log: with every row.
        prepared: see `real_replay.prepare`.
        robot: that it is of.
        actuator: motors about as those of the robot.
    """
    if log.posture is not None:
        names = [POSTURES[code] for code in np.unique(log.posture)]
        return Posture(names[0], f"{' and '.join(names)}, as the log states")
    if robot.base == "fixed":
        return Posture("fixed", "fixed, as the robot's base")
    standing, hung = (
        Replayer(with_posture(log, name), robot, with_posture(prepared, name)) for name in ("standing", "hung")
    )
    hung.compared = standing.compared  # the same rows, up to a fall
    error = {
        name: float(np.nanmean(each.run(actuator).rmse)) for name, each in (("standing", standing), ("hung", hung))
    }
    said = f"replayed with {1e3 * error['standing']:.1f} mrad standing and {1e3 * error['hung']:.1f} mrad hung"
    name = "hung" if error["hung"] < MARGIN * error["standing"] else "standing"
    return Posture(name, f"{name}: {said}")
