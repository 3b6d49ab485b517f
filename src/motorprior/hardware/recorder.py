"""A recording that survives a crash: one CSV line per accepted frame, written at once and never rewritten."""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.readers.robot_run import Mode, run_columns
from motorprior.robots.robot import Robot


class Recorder:
    """Writes the format of `logs.readers.robot_run.read_robot_run`; the file is created at the first measurement.

    A written line survives the death of this process. It is not forced to the disk, which would stop the control loop,
    so a power failure loses the last seconds. Raises ArtifactError if the file exists already.
    """

    def __init__(self, robot: Robot, path: Path):
        if path.exists():
            remedy = "recordings are not overwritten: choose another folder"
            raise ArtifactError("it exists already", where=path, remedy=remedy)
        self.path, self._joint_names = path, robot.joint_names
        self._file: int | None = None
        self._format, self._with_current = "", False
        self._targets: deque[tuple[float, np.ndarray, Mode]] = deque(maxlen=32)

    def sent(self, time: float, target: np.ndarray, mode: Mode) -> None:
        """Store a (joints,) target [rad] that was sent at ``time`` [s] on the host's clock."""
        self._targets.append((time, target, mode))

    def idle(self) -> None:
        """The robot is idle: nothing to record until the next target."""
        self._targets.clear()

    def write(self, measurement: Measurement) -> None:
        """Record a measurement made while a target was in force; raises ArtifactError if the disk is full."""
        in_force = next((sent for sent in reversed(self._targets) if sent[0] <= measurement.sampled), None)
        if in_force is None or (self._with_current and measurement.telemetry.cur is None):
            return
        try:
            self._append(self._row(measurement, *in_force))
        except OSError as error:
            remedy = "free some space, or choose another folder"
            raise ArtifactError(f"cannot write ({error.strerror})", where=self.path, remedy=remedy) from error

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _append(self, line: str) -> None:
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        data = line.encode()
        if os.write(self._file, data) < len(data):
            raise OSError(0, "the disk is full")

    def _row(self, measurement: Measurement, sent: float, target: np.ndarray, mode: Mode) -> str:
        telemetry = measurement.telemetry
        if not self._format:
            self._with_current = telemetry.cur is not None
            columns = run_columns(self._joint_names, self._with_current)
            self._append(",".join(columns) + "\n")
            self._format = "%.3f,%d,%.4f" + ",%.7g" * (len(columns) - 3) + "\n"
        now = 1e-3 * telemetry.ts
        since = now + sent - measurement.sampled
        values = [now, int(mode), since, *target.tolist(), *telemetry.pos.tolist(), *telemetry.vel.tolist()]
        if self._with_current and telemetry.cur is not None:
            values += telemetry.cur.tolist()
        return self._format % (*values, *telemetry.attitude, *telemetry.rates)
