"""A recording that outlives its writer: one CSV line per accepted frame, written at once and never rewritten."""

from __future__ import annotations

import contextlib
import os
from collections import deque
from pathlib import Path

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode, run_columns
from motorprior.robots.robot import Robot

_KEPT_TARGETS = 32


class Recorder:
    """Writes what `logs.robot_run.read_robot_run` reads; the file begins with the first measurement.

    A line that was written survives the death of this process; nothing is forced to the disk, because that would stop
    the control loop, so a loss of power costs the last seconds.

    Args:
        robot: whose measurements they are.
        path: file to create; its folder is made, if it was not there.

    Raises:
        ArtifactError: the file exists already, or cannot be written.
    """

    def __init__(self, robot: Robot, path: Path):
        self.path, self._joint_names = path, robot.joint_names
        self._made = [folder for folder in path.parents if not folder.exists()]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError as error:
            remedy = "recordings are not overwritten: choose another folder"
            raise ArtifactError("it exists already", where=path, remedy=remedy) from error
        except OSError as error:
            raise ArtifactError(
                f"cannot write ({error.strerror})", where=path, remedy="choose another folder"
            ) from error
        self._format: str | None = None
        self._with_current = False
        self._targets: deque[tuple[float, np.ndarray, Mode]] = deque(maxlen=_KEPT_TARGETS)
        self.rows = 0

    def sent(self, time: float, target: np.ndarray, mode: Mode) -> None:
        """Remember a (joints,) target [rad] that went out at ``time`` [s] on the host's clock."""
        self._targets.append((time, target, mode))

    def released(self) -> None:
        """The robot is idle: until the next target there is nothing to record."""
        self._targets.clear()

    def write(self, measurement: Measurement) -> None:
        """Record a measurement, if a target was in force when it was made.

        Raises:
            ArtifactError: the disk is full.
        """
        in_force = next((sent for sent in reversed(self._targets) if sent[0] <= measurement.sampled), None)
        telemetry = measurement.telemetry
        if in_force is None or (self._with_current and telemetry.cur is None):
            return
        self._append(self._row(measurement, *in_force))
        self.rows += 1

    def close(self) -> None:
        """End the file; one that holds nothing is removed, with the folders made for it that hold nothing else."""
        os.close(self._file)
        if self.rows == 0:
            self.path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                for folder in self._made:
                    folder.rmdir()

    def _append(self, line: str) -> None:
        data = line.encode()
        try:
            written = os.write(self._file, data)
        except OSError as error:
            raise ArtifactError(
                f"cannot write ({error.strerror})", where=self.path, remedy="free some space"
            ) from error
        if written < len(data):
            raise ArtifactError("cannot write (the disk is full)", where=self.path, remedy="free some space")

    def _row(self, measurement: Measurement, sent: float, target: np.ndarray, mode: Mode) -> str:
        telemetry = measurement.telemetry
        if self._format is None:
            self._with_current = telemetry.cur is not None
            columns = run_columns(self._joint_names, self._with_current)
            self._append(",".join(columns) + "\n")
            self._format = "%.3f,%d,%.4f" + ",%.7g" * (len(columns) - 3) + "\n"
        now = 1e-3 * telemetry.ts
        since = now + sent - measurement.sampled
        values = [now, int(mode), since, *target.tolist(), *telemetry.pos.tolist(), *telemetry.vel.tolist()]
        if self._with_current and telemetry.cur is not None:
            values += telemetry.cur.tolist()
        values += [telemetry.roll, telemetry.pitch, telemetry.yaw]
        values += [telemetry.roll_rate, telemetry.pitch_rate, telemetry.yaw_rate]
        return self._format % tuple(values)
