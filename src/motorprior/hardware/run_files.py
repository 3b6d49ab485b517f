"""run.json and figures.json of a run, also written if it ends with a fault."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from motorprior.artifacts import write_json
from motorprior.exceptions import ArtifactError
from motorprior.hardware.control_loop import Timing, clock_figures
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.session import fault_of
from motorprior.hardware.settings import RunSettings


class RunFiles:
    """Settings, gains, limits, outcome and timing of a run.

    run.json is written when the robot is armed, and again when the run has ended, with its outcome: "time", "operator",
    the name of a signal, or the kind of a fault and its message. Infinite limits are null.

    Attributes:
        timing: of the control loop, to be filled.
        outcome: reason for the end of the run, if not an error.
    """

    def __init__(self, folder: Path, link: RobotLink):
        self._folder, self._link = folder, link
        self._record: dict[str, Any] = {}
        self.timing, self.outcome = Timing(), ""

    def begin(self, command: str, port: str, settings: RunSettings, gains: Gains, **more: Any) -> None:
        """Before the first command, write the settings, gains, limits and ``more``."""
        self._record = {
            "command": command,
            "port": port,
            "robot": self._link.robot.name,
            "started": _now(),
            "settings": {name: str(v) if isinstance(v, Path) else v for name, v in asdict(settings).items()},
            "gains": asdict(gains),
            "safety": {name: v if math.isfinite(v) else None for name, v in asdict(self._link.limits).items()},
            **more,
        }
        write_json(self._folder / "run.json", self._record)

    @contextlib.contextmanager
    def written_at_end(self) -> Iterator[None]:
        """On exit, when the robot is idle, write how the run ended, if it had begun."""
        try:
            yield
        except BaseException as error:
            kind = fault_of(error).kind if isinstance(error, Exception) else type(error).__name__
            with contextlib.suppress(ArtifactError):  # the error that ended the run is more important
                self._end(kind, str(error))
            raise
        self._end(self.outcome, None)

    def _end(self, outcome: str, message: str | None) -> None:
        if not self._record:
            return
        link, stream = self._link, self._link.stream
        frames = {name: getattr(stream, name) for name in ("accepted", "repeated", "impossible")}
        ending = {
            "ended": _now(),
            "outcome": outcome,
            "message": message,
            "position_clips": link.position_clips,
            "slew_clips": link.slew_clips,
            "commands": link.sent,
            "frames": frames | {"damaged": link.rejected},
        }
        write_json(self._folder / "run.json", self._record | ending)
        write_json(self._folder / "figures.json", clock_figures([self.timing], link.robot.control_dt))


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
