"""The log that a prior is fitted to: the folder of a bench, or motor logs, joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from motorprior.logs.motor_log import MotorLog, motion_digest

MOTIONS = "motions"  # key in a prior's provenance: `motion_digest` of every log that it was trained on


@dataclass(frozen=True)
class Origin:
    """Robot, motor and provenance of a log, for the prior."""

    robot: str
    motor: str
    provenance: dict[str, Any]


def origin_of(log: MotorLog, parts: Sequence[MotorLog]) -> Origin:
    """Origin of a log that was joined from ``parts``."""
    return Origin(log.robot, log.motor, {"log": log.source, MOTIONS: [motion_digest(part) for part in parts]})
