"""The posture of every log of a robot: from an option, from the log, or from replays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.progress import Progress
from motorprior.robots.robot import Robot
from motorprior.transfer.log_replay import Replayer, logged_gains_note, with_logged_gains
from motorprior.transfer.posture import find_posture, with_posture

PostureName: TypeAlias = Literal["auto", "standing", "suspended"]


def replayers_of(
    logs: Mapping[str, MotorLog],
    prepared: Mapping[str, MotorLog],
    robot: Robot,
    fleet: Fleet,
    posture: PostureName,
    progress: Progress,
) -> dict[str, Replayer]:
    """Every log with its posture, ready to replay; notes state posture and logged gains.

    Args:
        logs: by name, with every row.
        prepared: the same, see `log_replay.prepare`.
        robot: of the logs.
        fleet: its central motor is replayed to find an unknown posture.
        posture: of every log; ``auto`` for the logged one, or if there is none, the one that replays better.
        progress: receives the notes.

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
        progress.note(f"log {name}: {evidence}" + (f"; {excluded} rows after a fall are excluded" if excluded else ""))
        if gains := logged_gains_note(log):
            progress.note(f"log {name}: {gains}")
    return found
