"""Files beside the recording of a run: run.json and figures.json, whatever ends it."""

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
from motorprior.hardware.machine import BareTimers, MachineReport, explained, machine_facts
from motorprior.hardware.real_time import granted
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, fault_of

FACTS, FIGURES = "run.json", "figures.json"


class RunFacts:
    """Settings, gains, limits and outcome of a run, for a reader of its recording.

    run.json is written when the robot is armed, and again when the run has ended, with its outcome: "time", "pilot",
    the name of a signal, or the kind of a fault and its message. Infinite limits, those not applied, are null. Under
    "machine" stands what the system granted and, in the end, whether it kept its time beside the run, see `machine`.

    Attributes:
        outcome: what ended the run, unless an error did.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._facts: dict[str, Any] | None = None
        self._timer: BareTimers | None = None
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
        self._facts = {
            "command": command,
            "port": port,
            "robot": link.robot.name,
            "started": _now(),
            "settings": {name: str(v) if isinstance(v, Path) else v for name, v in asdict(settings).items()},
            "gains": asdict(gains),
            "machine": granted(),
            "safety": {name: v if math.isfinite(v) else None for name, v in asdict(link.limits).items()},
            **(more or {}),
        }
        write_json(self._folder / FACTS, self._facts)
        self._timer = BareTimers()

    @contextlib.contextmanager
    def kept(self, link: RobotLink, timing: Timing, period: float) -> Iterator[None]:
        """Write how the run ended when this is left, if it had begun; the robot is idle by then.

        Raises:
            ArtifactError: it cannot be written, and nothing else went wrong.
            RobotFault: the one that ended the run; a silence of the host is explained, see `machine.explained`.
        """
        try:
            yield
        except RobotFault as fault:
            report = self._stop_timer()
            told = explained(fault, report, timing, period)
            with contextlib.suppress(ArtifactError):  # what ended the run matters more
                self._end(link, timing, period, told, report)
            if told is fault:
                raise
            raise told from fault
        except BaseException as error:
            with contextlib.suppress(ArtifactError):
                self._end(link, timing, period, error, self._stop_timer())
            raise
        self._end(link, timing, period, None, self._stop_timer())

    def _stop_timer(self) -> MachineReport | None:
        timer, self._timer = self._timer, None
        return None if timer is None else timer.stop()

    def _end(
        self,
        link: RobotLink,
        timing: Timing,
        period: float,
        error: BaseException | None,
        report: MachineReport | None,
    ) -> None:
        if self._facts is None:
            return
        measured = {} if report is None else machine_facts(report, timing, period)
        stream = link.stream
        ending = {
            "ended": _now(),
            "outcome": self.outcome if error is None else _kind(error),
            "message": None if error is None else str(error),
            "position_clips": link.position_clips,
            "slew_clips": link.slew_clips,
            "commands": link.sent,
            "machine": self._facts["machine"] | measured,
            "frames": {
                "believed": stream.accepted,
                "repeated": stream.repeated,
                "impossible": stream.impossible,
                "damaged": link.rejected,
            },
        }
        write_json(self._folder / FACTS, self._facts | ending)
        write_json(self._folder / FIGURES, clock_results([timing], period).to_figures())


def _kind(error: BaseException) -> str:
    if isinstance(error, RobotFault):
        return error.kind
    return fault_of(error).kind if isinstance(error, Exception) else type(error).__name__


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")
