"""The host's link to a robot at a serial port: receives, checks, records and sends.

Every command passes through the safety gate.
"""

import contextlib
import time
from collections import deque
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.health import Measurement, SensorFaults, TelemetryStream, TrackingFaults
from motorprior.hardware.protocol import IDLE_FRAME, Telemetry
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.watchdog import Watchdog
from motorprior.logs.readers.deploy_recording import Mode, run_columns
from motorprior.robots.robot import Robot, SafetyLimits

# Idle commands per burst. The first burst is longer than a command that was sent only in part: the
# robot reads its beginning as the rest of this command. The other bursts replace lost frames.
_IDLE_BURSTS = (30, 1, 1, 1)
_IDLE_PAUSE = 0.01  # time between two bursts [s]
# Gains are sent before each of the first targets, because a command can get lost. They are not sent
# later: without a checksum, a damaged gain or current limit makes a walking robot fall
# (`benchmarks/noise.py`).
_NUM_GAINS = 3  # number of targets before which the gains are sent
_CATCH_UP = 0.02  # time to read telemetry that is buffered in the kernel [s]
_MAX_LATE_READS = 100  # reads after the deadline: a device may send endlessly


class RobotLink:
    """A host's link to one robot, which is idle until it is armed.

    The end of the ``with`` block makes the robot idle and closes the port. ``limits`` of gate and
    checks are the robot's own if not given. ``recorder`` gets every accepted measurement.
    """

    def __init__(
        self,
        robot: Robot,
        port: SerialLink,
        limits: SafetyLimits | None = None,
        recorder: "Recorder | None" = None,
    ):
        self.robot = robot
        self.port = port
        self._recorder = recorder
        wire = robot.require_wire()
        self._signs = wire.joint_signs
        self.limits = limits or wire.safety
        self.gate = SafetyGate(robot, self.limits)
        self.stream = TelemetryStream(self.limits)
        self.text: deque[str] = deque(maxlen=50)  # the last lines that the robot printed
        self.sent = 0  # commands with a target since arming
        self._watchdog: Watchdog | None = None
        self._sensors = SensorFaults(robot, self.limits)
        self._tracking = TrackingFaults(robot.joint_names, self.limits, wire.kd / wire.kp)
        # measurements since the last check; bounded, since an idle host may never check
        self._unchecked: deque[Measurement] = deque(maxlen=1000)
        # line with "ERROR" that the robot printed since the last check
        self._error_line: str | None = None
        self._ignored: set[str] = set()  # names of faults that do not end a motion

    def __enter__(self) -> "RobotLink":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.idle()
        finally:
            self.port.close()
            if self._recorder is not None:
                self._recorder.close()

    def receive(self, until: float) -> list[Measurement]:
        """Accepted telemetry until ``until`` [s] on the monotonic clock.

        After this time it also reads what has already arrived.
        """
        late_reads = 0
        received: list[Measurement] = []
        while late_reads < _MAX_LATE_READS:
            messages = self.port.wait(until)
            for arrival, message in messages:
                if isinstance(message, str):
                    self._read_text(message)
                    continue
                measurement = self.stream.accept(message.with_signs(self._signs), arrival)
                if measurement is not None:
                    received.append(measurement)
                    self._unchecked.append(measurement)
                    if self._recorder is not None:
                        self._recorder.write(measurement)

            if time.monotonic() >= until:
                if not messages:
                    break
                late_reads += 1
        return received

    def _read_text(self, line: str) -> None:
        self.text.append(line)
        if "ERROR" in line:
            self._error_line = line

    def resume_after_pause(self) -> None:
        """Wait for a fresh measurement after this host skipped control steps."""
        give_up = time.monotonic() + _CATCH_UP
        while (now := time.monotonic()) < give_up:
            latest = self.stream.latest
            if latest is not None and now - latest.sampled <= self.robot.control_dt:
                break
            self.receive(now + 0.001)

        latest = self.stream.latest
        if latest is not None:
            self._tracking.restart_window(1e-3 * latest.telemetry.ts)

    def check(self) -> Measurement:
        """The latest measurement; raises RobotFault for the first fault (docs/hardware.md)."""
        if self._error_line is not None:
            line = self._error_line
            self._error_line = None
            raise RobotFault(
                "firmware", f"the robot reports {line!r}", remedy="switch it off and on again"
            )

        unchecked = list(self._unchecked)
        self._unchecked.clear()
        latest = self.stream.fresh(time.monotonic())
        # Check every frame in turn, not only the latest: a joint that moved there and back during a
        # pause of the host was not stuck.
        for measurement in unchecked:
            for fault in self._faults(measurement.telemetry):
                if fault.name not in self._ignored:
                    raise fault
        return latest

    def _faults(self, telemetry: Telemetry) -> Iterator[RobotFault]:
        now = 1e-3 * telemetry.ts
        target = self.gate.target
        yield from self._sensors.faults(telemetry, now)
        if target is not None:
            yield from self._tracking.faults(telemetry.pos, target, now)

    def arm(self, gains: Gains) -> None:
        """Start the watchdog, and make the present joint positions the target.

        Nothing is sent before the first `send`.
        """
        self._ignored.clear()
        self._watchdog = Watchdog(self.port.fileno(), self.limits.watchdog, IDLE_FRAME)
        # telemetry that arrived while the watchdog started
        self.receive(time.monotonic() + _CATCH_UP)
        self.gate.arm(gains, self.check().telemetry.pos, time.monotonic())
        self.sent = 0
        self._tracking.begin(gains.kd / gains.kp)

    def send(self, target: np.ndarray, mode: Mode) -> float:
        """Send (joints,) position targets [rad]; returns the time of sending [s].

        Raises RobotFault if the target is invalid, the robot not armed, the watchdog tripped or
        dead, or the port gone.
        """
        if self._watchdog is not None:
            self._watchdog.beat()
        command = self.gate.limited(target, time.monotonic())
        if self.sent < _NUM_GAINS:
            self.port.send(self.gate.gains)
        sent = self.port.send(command)
        self.sent += 1

        target_in_force = self.gate.target
        if self._recorder is not None and target_in_force is not None:
            self._recorder.sent(sent, target_in_force, mode)
        return sent

    def ignore(self, fault_name: str) -> None:
        """Continue in spite of faults with this `RobotFault.name`, to crouch."""
        self._ignored.add(fault_name)
        if fault_name == "watchdog" and self._watchdog is not None:
            self._watchdog.end(idle_sent=True, patience=0.005)  # the robot still moves
            self._watchdog = None

    def idle(self) -> None:
        """Remove the current from all motors; never fails.

        If the port does not accept the command, the watchdog repeats it.
        """
        if self.gate.target is not None:
            self.send_idle()
        if self._watchdog is not None:
            watchdog = self._watchdog
            self._watchdog = None
            watchdog.end(idle_sent=not self.port.unsent)
        if self._recorder is not None:
            self._recorder.idle()

    def send_idle(self) -> None:
        """Send idle, also to a robot that this host never armed: its legs can be moved by hand."""
        command = self.gate.idle()
        self.port.discard_unsent()
        for repeats in _IDLE_BURSTS:
            with contextlib.suppress(MotorPriorError):  # the port may be gone
                for _ in range(repeats):
                    self.port.send(command)
            time.sleep(_IDLE_PAUSE)


class Recorder:
    """Writes the format of `read_deploy_recording`; the file is created at the first measurement.

    A written line survives the death of this process. It is not forced to the disk, which would
    stop the control loop, so a power failure loses the last seconds. Raises ArtifactError if the
    file exists already.
    """

    def __init__(self, robot: Robot, path: Path):
        if path.exists():
            raise ArtifactError(
                "it exists already",
                where=path,
                remedy="recordings are not overwritten: choose another folder",
            )
        self._path = path
        self._joint_names = robot.joint_names
        self._file: FileIO | None = None
        self._with_current = False
        self._failed = False
        # (time of sending, target, mode) of the last commands
        self._targets: deque[tuple[float, np.ndarray, Mode]] = deque(maxlen=32)

    def sent(self, time: float, target: np.ndarray, mode: Mode) -> None:
        """Store a (joints,) target [rad] that was sent at ``time`` [s] on the host's clock."""
        self._targets.append((time, target, mode))

    def idle(self) -> None:
        """The robot is idle: nothing to record until the next target."""
        self._targets.clear()

    def write(self, measurement: Measurement) -> None:
        """Record a measurement made while a target was in force.

        Raises ArtifactError if the disk is full.
        """
        target_in_force = self._target_at(measurement.sampled)
        lacks_current = self._with_current and measurement.telemetry.cur is None
        if self._failed or target_in_force is None or lacks_current:
            return
        try:
            if self._file is None:
                self._file = self._created(measurement)
            _append(self._file, self._row(measurement, *target_in_force))
        except OSError as error:
            # the error ends the motion; it is raised only once, so that the robot can crouch
            self._failed = True
            raise ArtifactError(
                f"cannot write ({error.strerror})",
                where=self._path,
                remedy="free some space, or choose another folder",
            ) from error

    def _target_at(self, time: float) -> tuple[float, np.ndarray, Mode] | None:
        """The last command that was sent by ``time`` [s]; None if the robot was idle."""
        for command in reversed(self._targets):
            if command[0] <= time:
                return command
        return None

    def _created(self, measurement: Measurement) -> FileIO:
        """The new file, with a line of column names.

        It has columns of currents if the first measurement has currents.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file = self._path.open("xb", buffering=0)
        self._with_current = measurement.telemetry.cur is not None
        _append(file, ",".join(run_columns(self._joint_names, self._with_current)))
        return file

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def _row(self, measurement: Measurement, sent: float, target: np.ndarray, mode: Mode) -> str:
        telemetry = measurement.telemetry
        now = 1e-3 * telemetry.ts
        sent_on_robot_clock = now + sent - measurement.sampled
        values = [
            now,
            int(mode),
            sent_on_robot_clock,
            *target.tolist(),
            *telemetry.pos.tolist(),
            *telemetry.vel.tolist(),
        ]
        if self._with_current and telemetry.cur is not None:
            values += telemetry.cur.tolist()
        values += (*telemetry.attitude, *telemetry.rates)
        return ("%.3f,%d,%.4f" + ",%.7g" * (len(values) - 3)) % tuple(values)


def _append(file: FileIO, line: str) -> None:
    data = f"{line}\n".encode()
    if file.write(data) < len(data):
        raise OSError(0, "the disk is full")
