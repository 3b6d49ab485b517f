"""The host's link to a robot at a serial port: receives, checks, records, and sends through the safety gate."""

import contextlib
import time
from collections import deque
from io import FileIO
from itertools import chain
from pathlib import Path

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.health import Measurement, SensorFaults, TelemetryStream, TrackingFaults
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.watchdog import Watchdog
from motorprior.logs.readers.deploy_recording import Mode, run_columns
from motorprior.robots.robot import Robot, SafetyLimits

# Idle commands per burst: the first is longer than a command that was sent in part, the others
# replace lost frames.
_IDLE_BURSTS = (30, 1, 1, 1)
_IDLE_PAUSE = 0.01  # [s] between bursts
# Gains are sent before each of the first targets, because a command can get lost. They are not sent
# later: without a checksum, a damaged gain or current limit makes a walking robot fall
# (`benchmarks/noise.py`).
_NUM_GAINS = 3
_CATCH_UP = 0.02  # [s] to read telemetry that is buffered in the kernel


class RobotLink:
    """A host's link to one robot: idle until armed, idle again at the end of the ``with`` block, which closes its port.

    ``limits`` of gate and checks are the robot's own if not given. ``recorder`` gets every accepted
    measurement made while a target is in force.
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
        self._signs = robot.require_wire().joint_signs
        self.limits = limits = limits or robot.require_wire().safety
        self.gate = SafetyGate(robot, limits)
        self.stream = TelemetryStream(limits)
        self.text: deque[str] = deque(maxlen=50)  # the last lines that the robot printed
        self.sent = 0  # commands with a target since arming
        self._watchdog: Watchdog | None = None
        self._sensors = SensorFaults(robot, limits)
        self._tracking = TrackingFaults(robot, limits)
        # bounded: an idle host may never check
        self._unchecked: deque[Measurement] = deque(maxlen=1000)
        self._error_line: str | None = None
        self._ignored: set[str] = set()

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
        """Accepted telemetry until ``until`` [s] on the monotonic clock, and then all that has already arrived."""
        late_reads = 0
        received = list[Measurement]()
        while late_reads < 100:  # a device may send endlessly
            messages = self.port.wait(until)
            for arrival, message in messages:
                if isinstance(message, str):
                    self.text.append(message)
                    self._error_line = message if "ERROR" in message else self._error_line
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

    def resume_after_pause(self) -> None:
        """Wait for a fresh measurement after this host skipped control steps."""
        give_up = time.monotonic() + _CATCH_UP
        while (now := time.monotonic()) < give_up:
            latest = self.stream.latest
            if latest is not None and now - latest.sampled <= self.robot.control_dt:
                break
            self.receive(now + 0.001)
        if (latest := self.stream.latest) is not None:
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
        # Every frame in turn: after a pause of the host, a joint that moved there and back was not
        # stuck.
        for measurement in unchecked:
            telemetry = measurement.telemetry
            target = self.gate.target
            now = 1e-3 * measurement.telemetry.ts
            tracking = () if target is None else self._tracking.faults(telemetry.pos, target, now)
            for fault in chain(self._sensors.faults(telemetry, now), tracking):
                if fault.kind not in self._ignored:
                    raise fault
        return latest

    def arm(self, gains: Gains) -> None:
        """Start the watchdog, and hold the joints at their present positions with the first command."""
        self._ignored.clear()
        self._watchdog = Watchdog(self.port.fileno(), self.limits.watchdog)
        # telemetry that arrived while the watchdog started
        self.receive(time.monotonic() + _CATCH_UP)
        self.gate.arm(gains, self.check().telemetry.pos, time.monotonic())
        self.sent = 0
        self._tracking.begin(gains.kd / gains.kp)

    def send(self, target: np.ndarray, mode: Mode) -> float:
        """Send (joints,) position targets [rad]; returns the time at which the command was sent [s].

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
        if self._recorder is not None and (target_in_force := self.gate.target) is not None:
            self._recorder.sent(sent, target_in_force, mode)
        return sent

    def ignore(self, kind: str) -> None:
        """Continue in spite of this kind of faults, to crouch."""
        self._ignored.add(kind)
        if kind == "watchdog" and self._watchdog is not None:
            self._watchdog.end(idle_sent=True, patience=0.005)  # the robot still moves
            self._watchdog = None

    def idle(self) -> None:
        """Remove the current from all motors; never fails. If the port does not accept it, the watchdog repeats it."""
        if self.gate.target is not None:
            self.send_idle()
        if self._watchdog is not None:
            watchdog = self._watchdog
            self._watchdog = None
            watchdog.end(idle_sent=not self.port.unsent)
        if self._recorder is not None:
            self._recorder.idle()

    def send_idle(self) -> None:
        """Send idle, also to a robot that this host never armed, so that legs move by hand."""
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
            remedy = "recordings are not overwritten: choose another folder"
            raise ArtifactError("it exists already", where=path, remedy=remedy)
        self._path = path
        self._joint_names = robot.joint_names
        self._file: FileIO | None = None
        self._with_current = self._failed = False
        self._targets: deque[tuple[float, np.ndarray, Mode]] = deque(maxlen=32)

    def sent(self, time: float, target: np.ndarray, mode: Mode) -> None:
        """Store a (joints,) target [rad] that was sent at ``time`` [s] on the host's clock."""
        self._targets.append((time, target, mode))

    def idle(self) -> None:
        """The robot is idle: nothing to record until the next target."""
        self._targets.clear()

    def write(self, measurement: Measurement) -> None:
        """Record a measurement made while a target was in force; raises ArtifactError if the disk is full."""
        in_force = next(
            (sent for sent in reversed(self._targets) if sent[0] <= measurement.sampled), None
        )
        if (
            self._failed
            or in_force is None
            or (self._with_current and measurement.telemetry.cur is None)
        ):
            return
        try:
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("xb", buffering=0)
                self._with_current = measurement.telemetry.cur is not None
                _append(self._file, ",".join(run_columns(self._joint_names, self._with_current)))
            _append(self._file, self._row(measurement, *in_force))
        except OSError as error:  # ends the motion, once: it must not prevent the crouch
            self._failed = True
            remedy = "free some space, or choose another folder"
            raise ArtifactError(
                f"cannot write ({error.strerror})", where=self._path, remedy=remedy
            ) from error

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def _row(self, measurement: Measurement, sent: float, target: np.ndarray, mode: Mode) -> str:
        telemetry = measurement.telemetry
        now = 1e-3 * telemetry.ts
        since = now + sent - measurement.sampled
        values = [
            now,
            int(mode),
            since,
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
