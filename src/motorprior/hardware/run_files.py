"""Files of a run besides its recording: run.json and figures.json, however it ends."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from motorprior.artifacts import write_json
from motorprior.exceptions import ArtifactError, RobotFault
from motorprior.hardware.control_loop import Timing, clock_results
from motorprior.hardware.real_time import real_time
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, fault_of


class RunFiles:
    """Settings, gains, limits, outcome and timing of a run.

    run.json is written when the robot is armed, and again when the run has ended, with its outcome: "time", "operator",
    the name of a signal, or the kind of a fault and its message. Infinite limits are null. "machine" is what the system
    permitted the control loop.

    Attributes:
        outcome: what ended the run, unless an error did.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._facts: dict[str, Any] | None = None
        self.outcome = ""

    def begin(
        self, command: str, port: str, settings: Any, gains: Gains, link: RobotLink, more: dict[str, Any] | None = None
    ) -> None:
        """Write what is known before the first command.

        Args:
            command: "deploy" or "record".
            port: path of the port.
            settings: dataclass of the user's choices.
            gains: to send.
            link: to the robot, with the limits in force.
            more: further facts.

        Raises:
            ArtifactError: it cannot be written.
        """
        with real_time() as permitted:
            pass
        self._facts = {
            "command": command,
            "port": port,
            "robot": link.robot.name,
            "started": _now(),
            "settings": {name: str(v) if isinstance(v, Path) else v for name, v in asdict(settings).items()},
            "gains": asdict(gains),
            "machine": permitted,
            "safety": {name: v if math.isfinite(v) else None for name, v in asdict(link.limits).items()},
            **(more or {}),
        }
        write_json(self._folder / "run.json", self._facts)

    @contextlib.contextmanager
    def written_at_end(self, link: RobotLink, timing: Timing, period: float) -> Iterator[None]:
        """Write how the run ended when this is closed, if it had begun; the robot is idle by then.

        Raises:
            ArtifactError: it cannot be written, and there was no other error.
        """
        try:
            yield
        except BaseException as error:
            with contextlib.suppress(ArtifactError):  # what ended the run matters more
                self._end(link, timing, period, error)
            raise
        self._end(link, timing, period, None)

    def _end(self, link: RobotLink, timing: Timing, period: float, error: BaseException | None) -> None:
        if self._facts is None:
            return
        stream = link.stream
        ending = {
            "ended": _now(),
            "outcome": self.outcome if error is None else _kind(error),
            "message": None if error is None else str(error),
            "position_clips": link.position_clips,
            "slew_clips": link.slew_clips,
            "commands": link.sent,
            "frames": {
                "accepted": stream.accepted,
                "repeated": stream.repeated,
                "impossible": stream.impossible,
                "damaged": link.rejected,
            },
        }
        write_json(self._folder / "run.json", self._facts | ending)
        write_json(self._folder / "figures.json", clock_results([timing], period).to_figures())


def _kind(error: BaseException) -> str:
    if isinstance(error, RobotFault):
        return error.kind
    return fault_of(error).kind if isinstance(error, Exception) else type(error).__name__


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
