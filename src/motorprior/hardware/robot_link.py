"""The host's link to a robot at a serial port: receives, checks, records, and sends through the safety gate."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from itertools import chain

import numpy as np

from motorprior.exceptions import ArtifactError, MotorPriorError, RobotFault
from motorprior.hardware.health import Sensors, Tracking, check_stream
from motorprior.hardware.protocol import IDLE, Command
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.telemetry_stream import Measurement, TelemetryStream
from motorprior.hardware.watchdog import Watchdog
from motorprior.logs.readers.robot_run import Mode
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits

# Idle commands per burst. The first burst is longer than any command, since part of one may have been sent; the others
# replace lost frames.
_IDLE_BURSTS = (30, 1, 1, 1)
_IDLE_PAUSE = 0.01  # [s] between bursts
# Gains precede the first targets only. Repeated, because a command can get lost. Not later, because there is no
# checksum: the next target corrects a damaged one, but a damaged gain or current limit makes a walking robot fall
# (`benchmarks/noise.py`).
_NUM_GAINS = 3
_CATCH_UP = 0.02  # [s] to read telemetry that is buffered in the kernel


class RobotLink:
    """A host's link to one robot: idle until armed, idle again when closed. Use it in a ``with`` block.

    Attributes:
        stream: accepted telemetry and its counters, in the library's signs.
        text: the last lines that the robot printed.
        sent: commands with a target since arming.
        position_clips, slew_clips: see `SafetyGate`; of the last motion, set once the robot is idle.

    Args:
        robot: with a wire.
        port: open; closed with the link.
        limits: of gate and checks; the robot's own if not given.
        recorder: gets every accepted measurement made while a target is in force; closed with the link.
    """

    def __init__(
        self, robot: Robot, port: SerialLink, limits: SafetyLimits | None = None, recorder: Recorder | None = None
    ):
        self.robot, self._wire = robot, robot.require_wire()
        self._port, self._recorder = port, recorder
        self.limits = limits = limits or self._wire.safety
        self.stream = TelemetryStream(limits)
        self.text: deque[str] = deque(maxlen=50)
        self.sent = self.position_clips = self.slew_clips = 0
        self._gate: SafetyGate | None = None
        self._watchdog: Watchdog | None = None
        self._sensors, self._tracking = Sensors(robot, limits), Tracking(robot, limits)
        self._unchecked: deque[Measurement] = deque(maxlen=1000)  # bounded: an idle host may never check
        self._error_line: str | None = None
        self._ignored: set[str] = set()

    def __enter__(self) -> RobotLink:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def rejected(self) -> int:
        """Damaged frames."""
        return self._port.rejected

    @property
    def gate(self) -> SafetyGate:
        """The gate of an armed robot; raises RobotFault if it is not armed."""
        if self._gate is None:
            raise RobotFault("not armed", "the robot is idle", remedy="arm it first")
        return self._gate

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target in force [rad], None while idle."""
        return None if self._gate is None else self._gate.target

    def receive(self, until: float) -> None:
        """Read telemetry until ``until`` [s] on the monotonic clock, and then all that has already arrived."""
        late_reads = 0
        while late_reads < 100:  # a device may send endlessly
            messages = self._port.wait(until)
            for arrival, message in messages:
                if isinstance(message, str):
                    self.text.append(message)
                    if "ERROR" in message:
                        self._error_line = message
                    continue
                measurement = self.stream.accept(message.with_signs(self._wire.joint_signs), arrival)
                if measurement is not None:
                    self._unchecked.append(measurement)
                    self._record(measurement)
            if time.monotonic() >= until:
                if not messages:
                    return
                late_reads += 1

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
            line, self._error_line = self._error_line, None
            raise RobotFault("firmware", f"the robot reports {line!r}", remedy="switch it off and on again")
        unchecked = list(self._unchecked)
        self._unchecked.clear()
        latest = check_stream(self.stream, self.limits, time.monotonic())
        # Every frame in turn: after a pause of the host, a joint that moved there and back was not stuck.
        for measurement in unchecked:
            self._check_robot(measurement)
        return latest

    def arm(self, gains: Gains) -> None:
        """Start the watchdog, and hold the joints at their present positions with the first command.

        Raises:
            ConfigError: gains out of range.
            RobotFault: a fault of the robot or the watchdog.
        """
        gate = SafetyGate(self.robot, self.limits, gains)
        self._ignored.clear()
        self._watchdog = Watchdog(self._port.fileno(), self.limits.watchdog)
        self.receive(time.monotonic() + _CATCH_UP)  # telemetry that arrived while the watchdog started
        measurement = self.check()
        gate.start_at(measurement.telemetry.pos, time.monotonic())
        self._gate, self.sent = gate, 0
        self._tracking.begin(gains.kd / gains.kp)

    def send(self, target: np.ndarray, mode: Mode) -> float:
        """Send (joints,) position targets [rad]; returns the time at which the command was sent [s].

        Raises RobotFault for an invalid target, a tripped or dead watchdog, or a disconnected port.
        """
        gate = self.gate
        if self._watchdog is not None:
            self._watchdog.beat()
        command = gate.limited(target, time.monotonic())
        if self.sent < _NUM_GAINS:
            self._port.send(gate.gains())
        sent = self._port.send(command)
        self.sent += 1
        if self._recorder is not None and (target_in_force := gate.target) is not None:
            self._recorder.sent(sent, target_in_force, mode)
        return sent

    def ignore(self, *kinds: str) -> None:
        """Continue in spite of these kinds of faults, to crouch."""
        self._ignored.update(kinds)
        if "watchdog" in kinds and self._watchdog is not None:
            self._watchdog.kill()
            self._watchdog = None

    def idle(self) -> None:
        """Remove the current from all motors; never fails. If the port does not accept it, the watchdog repeats it."""
        if self._gate is not None:
            self.position_clips, self.slew_clips = self._gate.position_clips, self._gate.slew_clips
            self._send_idle(self._gate.idle())
            self._gate = None
        if self._watchdog is not None:
            watchdog, self._watchdog = self._watchdog, None
            watchdog.end(idle_sent=not self._port.unsent)
        if self._recorder is not None:
            self._recorder.idle()

    def relax(self) -> None:
        """Remove the current from the motors of a robot that this host never armed, so that legs move by hand."""
        self._send_idle(IDLE)

    def close(self) -> None:
        """Idle, and close port and recording."""
        try:
            self.idle()
        finally:
            self._port.close()
            if self._recorder is not None:
                self._recorder.close()

    def _send_idle(self, command: Command) -> None:
        self._port.discard_unsent()
        for repeats in _IDLE_BURSTS:
            with contextlib.suppress(MotorPriorError):  # the port may be gone
                for _ in range(repeats):
                    self._port.send(command)
            time.sleep(_IDLE_PAUSE)

    def _check_robot(self, measurement: Measurement) -> None:
        telemetry, target, now = measurement.telemetry, self.target, 1e-3 * measurement.telemetry.ts
        tracking = () if target is None else self._tracking.faults(telemetry.pos, target, now)
        for fault in chain(self._sensors.faults(telemetry, now), tracking):
            if fault.kind not in self._ignored:
                raise fault

    def _record(self, measurement: Measurement) -> None:
        if self._recorder is None:
            return
        try:
            self._recorder.write(measurement)
        except ArtifactError:  # ends the motion, and must not prevent the crouch
            self._recorder.close()
            self._recorder = None
            raise
