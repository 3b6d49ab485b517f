"""Writes recordings of servos, see `logs.readers.servo_recording`."""

import json
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.hardware.buses.bus import Readings
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.logs.readers.servo_recording import HEADING, servo_columns

if TYPE_CHECKING:
    from motorprior.hardware.servo_link import ChainJoints


def require_new(path: Path) -> None:
    """Raise ArtifactError if the recording exists."""
    if path.exists():
        raise ArtifactError(
            "it exists already",
            where=path,
            remedy="recordings are not overwritten: choose another folder",
        )


class ServoRecorder:
    """Writes a recording, whose rows survive the death of this process.

    The file begins with ``header``, all that is known about servos and robot. Raises ArtifactError
    if the file exists already.
    """

    def __init__(self, path: Path, header: dict[str, Any]):
        require_new(path)
        self.path = path
        self.rows = 0
        self._header = header
        self._file: FileIO | None = None
        self._failed = False

    def write(
        self,
        reading: Readings,
        joints: "ChainJoints",
        target: np.ndarray,
        target_since: float,
        mode: Mode,
        part: int,
    ) -> None:
        """Record a reading made while the (n,) target [rad] was in force, since a time [s].

        Raises ArtifactError if the disk is full.
        """
        if self._failed:
            return
        time = 0.5 * (reading.begin + reading.end)
        values = [
            *target.tolist(),
            *joints.pos(reading.counts).tolist(),
            *joints.vel(reading.speed).tolist(),
            *reading.load.tolist(),
            *reading.current.tolist(),
            *reading.voltage.tolist(),
            *reading.temperature.tolist(),
        ]
        row = f"{time:.6f},{int(mode)},{part},{reading.begin:.6f},{reading.end:.6f},"
        row += f"{target_since:.6f}," + ",".join(f"{value:.7g}" for value in values)
        try:
            if self._file is None:
                self._file = self._created(joints.names)
            self._append(row)
        except OSError as error:
            # raised only once, so that the robot can return to rest
            self._failed = True
            raise ArtifactError(
                f"cannot write ({error.strerror})",
                where=self.path,
                remedy="free some space, or choose another folder",
            ) from error
        self.rows += 1

    def _created(self, joint_names: tuple[str, ...]) -> FileIO:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("xb", buffering=0)
        self._append(HEADING + json.dumps(self._header, sort_keys=True))
        self._append(",".join(servo_columns(joint_names)))
        return self._file

    def _append(self, line: str) -> None:
        assert self._file is not None
        data = f"{line}\n".encode()
        if self._file.write(data) < len(data):
            raise OSError(0, "the disk is full")

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
