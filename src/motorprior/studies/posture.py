"""Posture of a logged robot: from an option, from the log, or from replays of both postures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.robots.robot import Robot
from motorprior.signals import runs_of_true
from motorprior.studies.log_replay import Replayer, logged_gains_note, with_logged_gains

FALLEN_TILT = 0.8  # [rad] roll or pitch of a fallen robot
FALLEN_TIME = 0.2  # [s] minimum duration of this tilt
MARGIN = 0.7  # a log counts as suspended if its error suspended is below this share of its error standing


PostureName: TypeAlias = Literal["auto", "standing", "suspended"]


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


def replayers_of(
    logs: Mapping[str, MotorLog],
    prepared: Mapping[str, MotorLog],
    robot: Robot,
    fleet: Fleet,
    posture: PostureName,
    note: Callable[[str], None],
) -> dict[str, Replayer]:
    """Every log with its posture, ready to replay; notes state posture and logged gains.

    Args:
        logs: by name, with every row.
        prepared: the same, see `log_replay.prepare`.
        robot: of the logs.
        fleet: its central motor is replayed to find an unknown posture.
        posture: of every log; ``auto`` for the logged one, or if there is none, the one that replays better.
        note: called with the notes.

    Raises:
        ConfigError: a posture for a robot with a fixed base.
        LogError: a segment with two postures.
    """
    if posture != "auto" and robot.base == "fixed":
        problem = f"posture {posture!r}, but the base of {robot.name!r} is fixed"
        raise ConfigError(problem, remedy="leave it out", argument="posture")
    center, found = fleet.center(robot.num_joints), {}
    for name, log in logs.items():
        chosen, evidence = posture, f"{posture}, as given"
        if posture == "auto":
            chosen, evidence = find_posture(log, prepared[name], robot, with_logged_gains(center, log).actuator())
        logged = posture == "auto" and log.posture is not None
        rows, kept = (each if logged else with_posture(each, chosen) for each in (log, prepared[name]))
        found[name] = Replayer(rows, robot, kept)
        excluded = int((~found[name].compared).sum())
        note(f"log {name}: {evidence}" + (f"; {excluded} rows after a fall are excluded" if excluded else ""))
        if gains := logged_gains_note(log):
            note(f"log {name}: {gains}")
    return found
