"""The host's link to a robot at a serial port: receives, checks, and sends commands through the gate only."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Iterator
from types import TracebackType

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.axes import from_wire
from motorprior.hardware.guardian import Guardian
from motorprior.hardware.health import Extras, FrozenImu, Tilt, Tracking, check_stream
from motorprior.hardware.protocol import IDLE, Command
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.safety import SafetyGate
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.telemetry_stream import Measurement, TelemetryStream
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits

_IDLE_BURSTS = (30, 1, 1, 1)
"""Number of idle commands in each burst. The first burst is longer than any command, of which a part may have been
sent; the others are for lost frames."""
_IDLE_PAUSE = 0.01
"""Pause between bursts [s]."""
_LAW_FIRST = 3
"""The first so many targets come with the gains: any command may get lost, and what a firmware holds before the first
one is its own idea of a current limit. Later ones do not: no checksum guards them, and while the next target mends a
damaged one, a damaged gain or current limit throws a walking robot over (`benchmarks/noise.py`). Damage to the last
one that arrives stays until the robot is armed again."""
_KEPT_TEXT = 50
_CATCH_UP = 0.02
"""[s] in which telemetry comes that waited somewhere else than in this process."""
_GLANCE = 0.001
"""After a pause a fresh frame is waited for in pieces of so long [s]."""
_MOST_LATE_READS = 100
"""A device that sends without end must not be listened to without end."""
_MOST_UNCHECKED = 1000
"""Frames that wait for a check; while nothing moves nobody may ask for one."""


class RobotLink:
    """A host's link to one robot: idle until armed, idle again when closed. Use it in a ``with`` block.

    Attributes:
        robot: at the other end.
        limits: of the safety layer.
        stream: accepted telemetry and its counters, in the library's signs.
        text: the last lines that the robot printed.
        sent: commands with a target since it was armed.
        position_clips: see `SafetyGate`; of the last time that it was armed, known once it is idle.
        slew_clips: see `SafetyGate`; the same.

    Args:
        robot: with a wire.
        port: open; closed with the link.
        limits: see attributes; the robot's own if not given.
        recorder: gets every accepted measurement made under a target; closed with the link.
    """

    def __init__(
        self, robot: Robot, port: SerialLink, limits: SafetyLimits | None = None, recorder: Recorder | None = None
    ):
        self.robot, self._wire = robot, robot.require_wire()
        self._port, self._recorder = port, recorder
        self.limits = limits = limits or self._wire.safety
        self.stream = TelemetryStream(limits)
        self.text: list[str] = []
        self.sent = self.position_clips = self.slew_clips = 0
        self._gate: SafetyGate | None = None
        self._guardian: Guardian | None = None
        self._tilt, self._imu, self._tracking = Tilt(limits), FrozenImu(limits), Tracking(robot, limits)
        self._extras = Extras(robot, limits)
        self._unchecked: deque[Measurement] = deque(maxlen=_MOST_UNCHECKED)
        self._error_line: str | None = None
        self._forgiven: set[str] = set()

    def __enter__(self) -> RobotLink:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @property
    def rejected(self) -> int:
        """Damaged frames."""
        return self._port.rejected

    @property
    def gate(self) -> SafetyGate:
        """The gate of an armed robot.

        Raises:
            RobotFault: it is not armed.
        """
        if self._gate is None:
            raise RobotFault("not armed", "the robot is idle", remedy="arm it first")
        return self._gate

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target in force [rad], None while idle."""
        return None if self._gate is None else self._gate.target

    def receive(self, until: float) -> None:
        """Read messages of the robot until ``until`` [s] on the monotonic clock; at least what is there already.

        After a pause of this host much may be there, and only the last of it is new.

        Raises:
            RobotFault: the port is gone.
        """
        late_reads = 0
        while late_reads < _MOST_LATE_READS:
            heard = self._port.wait(until)
            for arrival, message in heard:
                if isinstance(message, str):
                    self._hear(message)
                    continue
                measurement = self.stream.take(from_wire(self._wire, message), arrival)
                if measurement is not None:
                    self._unchecked.append(measurement)
                    self._record(measurement)
            if time.monotonic() >= until:
                if not heard:
                    return
                late_reads += 1

    def after_pause(self) -> None:
        """Go on after this host left out control steps, in which telemetry waited and joints rested.

        Raises:
            RobotFault: see `receive`.
        """
        give_up = time.monotonic() + _CATCH_UP
        while (now := time.monotonic()) < give_up:
            latest = self.stream.latest
            if latest is not None and now - latest.sampled <= self.robot.control_dt:
                break
            self.receive(now + _GLANCE)
        if (latest := self.stream.latest) is not None:
            self._tracking.begin_again(1e-3 * latest.telemetry.ts)

    def check(self) -> Measurement:
        """The latest measurement, of a robot without a fault.

        Raises:
            RobotFault: the first thing that is wrong; see docs/hardware.md.
        """
        if self._error_line is not None:
            line, self._error_line = self._error_line, None
            raise RobotFault("firmware", f"the robot says {line!r}", remedy="switch it off and on again")
        unchecked = list(self._unchecked)
        self._unchecked.clear()
        measurement = check_stream(self.stream, self.limits, time.monotonic())
        for one in unchecked:
            self._check_robot(one)
        return measurement

    def arm(self, kp: float, kd: float, max_current: float) -> None:
        """Start the watchdog and take hold of the joints where they are.

        Raises:
            RobotFault: something is wrong with the robot, the gains, or the watchdog.
        """
        gate = SafetyGate(self.robot, self.limits, kp, kd, max_current)
        self._forgiven.clear()
        self._guardian = Guardian(self._port.fileno(), self.limits.watchdog)
        self.receive(time.monotonic() + _CATCH_UP)  # what came while the watchdog started
        measurement = self.check()
        gate.take_hold(measurement.telemetry.pos, time.monotonic())
        self._gate, self.sent = gate, 0
        self._tracking.begin(kd / kp)

    def send(self, target: np.ndarray, mode: Mode) -> float:
        """Hold (joints,) position targets [rad]; returns when the command left [s].

        Raises:
            RobotFault: the gate refuses it, the watchdog has tripped, or the port is gone.
        """
        gate = self.gate
        if self._guardian is not None:
            self._guardian.beat()
        command = gate.admit(target, time.monotonic())
        if self.sent < _LAW_FIRST:
            self._port.send(gate.law())
        sent = self._port.send(command)
        self.sent += 1
        if self._recorder is not None and (target_in_force := gate.target) is not None:
            self._recorder.sent(sent, target_in_force, mode)
        return sent

    def forgive(self, *kinds: str) -> None:
        """Go on in spite of faults that leave time to sit down."""
        self._forgiven.update(kinds)
        if "watchdog" in kinds and self._guardian is not None:
            self._guardian.kill()
            self._guardian = None

    def idle(self) -> None:
        """Take the current from all motors, in every state of the host. Idle is sent several times: frames get lost.

        Where the port does not take it, the watchdog goes on sending it for a second.
        """
        if self._gate is not None:
            self.position_clips, self.slew_clips = self._gate.position_clips, self._gate.slew_clips
            self._send_idle(self._gate.idle())
            self._gate = None
        if self._guardian is not None:
            guardian, self._guardian = self._guardian, None
            if self._port.unsent:
                guardian.abandon()
            else:
                guardian.release()
        if self._recorder is not None:
            self._recorder.released()

    def relax(self) -> None:
        """Take the current from the motors of a robot that this host never armed, so that legs move by hand."""
        self._send_idle(IDLE)

    def close(self) -> None:
        """Idle, and give port and recording back."""
        try:
            self.idle()
        finally:
            self._port.close()
            if self._recorder is not None:
                self._recorder.close()

    def _send_idle(self, command: Command) -> None:
        self._port.forget_unsent()
        for repeats in _IDLE_BURSTS:
            with contextlib.suppress(MotorPriorError):  # the port may be gone
                for _ in range(repeats):
                    self._port.send(command)
            time.sleep(_IDLE_PAUSE)

    def _check_robot(self, measurement: Measurement) -> None:
        """Every frame, in turn: after a pause of the host, a joint that moved there and back did not stand still."""
        telemetry, now = measurement.telemetry, 1e-3 * measurement.telemetry.ts
        with self._unless_forgiven():
            self._extras.check(telemetry, now)
        with self._unless_forgiven():
            self._imu.check(telemetry, now)
        self._tilt.check(telemetry, now)
        if (target := self.target) is not None:
            with self._unless_forgiven():
                self._tracking.check(telemetry.pos, target, now)

    @contextlib.contextmanager
    def _unless_forgiven(self) -> Iterator[None]:
        try:
            yield
        except RobotFault as fault:
            if fault.kind not in self._forgiven:
                raise

    def _record(self, measurement: Measurement) -> None:
        """A recording that fails ends the motion, and must not hinder the way down."""
        if (recorder := self._recorder) is None:
            return
        try:
            recorder.write(measurement)
        except ArtifactError:
            self._recorder = None
            recorder.close()
            raise

    def _hear(self, line: str) -> None:
        self.text = [*self.text[1 - _KEPT_TEXT :], line]
        if "ERROR" in line:
            self._error_line = line
