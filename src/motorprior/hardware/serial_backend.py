"""A robot at a serial port as a `Backend`: the same environment and policy as in simulation."""

from __future__ import annotations

import time

import numpy as np

from motorprior.backend import BackendState
from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.session import check_before_arming, ramp_to
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.wire_conversion import backend_state, servo_current
from motorprior.logs.readers.robot_run import Mode


class SerialBackend:
    """For the Gymnasium environment `locomotion.env.WalkEnv` on a real robot; `deploy` does not use it.

    `step` returns one control period after the step before. The caller must step again in time: after 130 ms without a
    step the watchdog makes the robot idle.

    Attributes:
        fault: the fault that made the robot idle (fault 1 in its states); None without one.

    Args:
        link: idle; closed with the backend.
        gains: to send; the robot's own if not given.
        need_imu: reject a robot whose IMU is not read.
    """

    def __init__(self, link: RobotLink, gains: Gains | None = None, need_imu: bool = True):
        self._link, self._need_imu = link, need_imu
        self._gains, self._period = gains or Gains.of(link.robot.require_wire()), link.robot.control_dt
        self._deadline, self._armed = 0.0, False
        self.fault: RobotFault | None = None
        self._last: Measurement | None = None

    def reset(self, seed: int) -> BackendState:
        """Ramp to the nominal pose; a real robot's motors do not depend on the seed. Raises RobotFault."""
        link = self._link
        try:
            if not self._armed:
                check_before_arming(link, self._need_imu)
                link.arm(self._gains)
                self._armed, self.fault = True, None
            loop = ControlLoop(link, link.limits, lambda: False)
            self._last = ramp_to(link, loop, link.robot.nominal_pose, Mode.RAMP, hold=0.3)
            link.gate.slow = False
        except RobotFault as fault:
            self._stop(fault)
            raise
        self._deadline = time.monotonic() + self._period
        return self._state()

    def step(self, position_target: np.ndarray) -> BackendState:
        """Send (joints,) targets [rad], within the limits of the safety gate, and wait until the period's end.

        A fault makes the robot idle and is reported in the state.
        """
        now = time.monotonic()  # a late step starts a new period, or its target would be in force too briefly
        if self._deadline - now < 0.5 * self._period:
            self._deadline = now + self._period
        try:
            self._link.send(position_target, Mode.WALK)
            self._link.receive(self._deadline)
            self._last = self._link.check()
        except RobotFault as fault:
            self._stop(fault)
        self._deadline += self._period
        return self._state()

    def close(self) -> None:
        """Idle, and close the port."""
        self._link.close()

    def _stop(self, fault: RobotFault) -> None:
        self.fault, self._armed = self.fault or fault, False
        self._link.idle()

    def _state(self) -> BackendState:
        assert self._last is not None, "reset first"
        telemetry, target, robot, gains = self._last.telemetry, self._link.target, self._link.robot, self._gains
        current = telemetry.cur
        if current is None and target is not None:
            current = servo_current(target, telemetry.pos, telemetry.vel, gains.kp, gains.kd, gains.max_current)
        torque = np.zeros(robot.num_joints) if current is None else robot.require_wire().torque_constant * current
        return backend_state(robot, telemetry, torque, int(self.fault is not None))
