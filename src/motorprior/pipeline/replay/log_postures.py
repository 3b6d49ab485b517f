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

PostureName: TypeAlias = Literal["auto", "standing", "hung"]


def replayers_of(
    logs: Mapping[str, MotorLog],
    prepared: Mapping[str, MotorLog],
    robot: Robot,
    fleet: Fleet,
    posture: PostureName,
    progress: Progress,
) -> dict[str, Replayer]:
    """Every log with its posture, ready to replay; posture and logged gains are noted.

    Args:
        logs: by name, with every row.
        prepared: the same, see `log_replay.prepare`.
        robot: of the logs.
        fleet: whose central motor is replayed to find an unknown posture.
        posture: of every log; ``auto`` to use that in the log, or to find it by replaying both.
        progress: receives the notes.

    Raises:
        ConfigError: a posture for a robot with a fixed base.
        LogError: a segment in two postures.
    """
    if posture != "auto" and robot.base == "fixed":
        raise ConfigError(
            f"posture {posture!r}, but the base of {robot.name!r} is fixed", remedy="leave it out", argument="posture"
        )
    center, found = fleet.center(robot.num_joints), {}
    for name, log in logs.items():
        if posture == "auto":
            known = find_posture(log, prepared[name], robot, with_logged_gains(center, log).actuator())
            chosen, evidence = known.name, known.evidence
        else:
            chosen, evidence = posture, f"{posture}, as given"
        stated = posture == "auto" and log.posture is not None
        both = [each if stated else with_posture(each, chosen) for each in (log, prepared[name])]
        found[name] = Replayer(both[0], robot, both[1])
        left = int((~found[name].compared).sum())
        progress.note(f"log {name}: {evidence}" + (f"; {left} rows after a fall are excluded" if left else ""))
        if gains := logged_gains_note(log):
            progress.note(f"log {name}: {gains}")
    return found
