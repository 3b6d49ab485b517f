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
from motorprior.hardware.control_loop import clock_figures
from motorprior.hardware.session import Session, fault_of
from motorprior.hardware.settings import RunSettings


class RunFiles:
    """Settings, gains, limits, outcome and timing of a session.

    run.json is written when the robot is armed, and again when the run has ended, with its outcome: "time", "operator",
    the name of a signal, or the kind of a fault and its message. Infinite limits are null.
    """

    def __init__(self, folder: Path, session: Session):
        self._folder, self._session = folder, session
        self._record: dict[str, Any] = {}

    def begin(self, command: str, port: str, settings: RunSettings, **more: Any) -> None:
        """Before the first command, write the settings, gains, limits and ``more``."""
        link = self._session.link
        self._record = {
            "command": command,
            "port": port,
            "robot": link.robot.name,
            "started": _now(),
            "settings": {name: str(v) if isinstance(v, Path) else v for name, v in asdict(settings).items()},
            "gains": asdict(self._session.gains),
            "safety": {name: v if math.isfinite(v) else None for name, v in asdict(link.limits).items()},
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
        self._end(self._session.outcome, None)

    def _end(self, outcome: str, message: str | None) -> None:
        if not self._record:
            return
        link = self._session.link
        frames = {name: getattr(link.stream, name) for name in ("accepted", "repeated", "impossible")}
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
        write_json(self._folder / "figures.json", clock_figures([self._session.timing], link.robot.control_dt))


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
