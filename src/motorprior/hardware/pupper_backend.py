"""A robot at a serial port behind the `Backend` contract: the same environment and policy as in simulation."""

from __future__ import annotations

import time

import numpy as np

from motorprior.backend import BackendState
from motorprior.exceptions import RobotFault
from motorprior.hardware.axes import backend_state
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.motions import ramp
from motorprior.hardware.robot import Robot
from motorprior.hardware.servo_law import servo_current
from motorprior.hardware.session import Gains, first_look
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.robot_run import Mode
from motorprior.robots.pupper_v2 import spec

FAULT = 1
"""Fault number of a state after which the robot is idle; `PupperBackend.fault` says why."""


class PupperBackend:
    """The door for the Gymnasium environment `locomotion.env.PupperWalkEnv` on a real robot; `deploy` does not use it.

    Holds targets in real time: `step` returns one control period after the step before. Whoever steps must come back in
    time: after 80 ms without a step the watchdog takes the current away.

    Attributes:
        fault: why the robot is idle, None while it is well.

    Args:
        robot: idle; closed with the backend.
        gains: to send.
        control_dt: control period [s].
        need_imu: refuse a robot whose IMU is not read.
    """

    def __init__(
        self, robot: Robot, gains: Gains | None = None, control_dt: float = spec.CONTROL_DT, need_imu: bool = True
    ):
        self._robot, self._gains, self._period, self._need_imu = robot, gains or Gains(), control_dt, need_imu
        self._deadline, self._armed = 0.0, False
        self.fault: RobotFault | None = None
        self._last: Measurement | None = None

    def reset(self, seed: int) -> BackendState:
        """Ramp to the nominal pose; the seed has no say in a real robot's motors.

        Raises:
            RobotFault: the robot is not well.
        """
        try:
            if not self._armed:
                first_look(self._robot, self._need_imu)
                self._robot.arm(self._gains.kp, self._gains.kd, self._gains.max_current)
                self._armed, self.fault = True, None
            limits, target = self._robot.limits, self._robot.gate.target
            assert target is not None, "armed"
            loop = ControlLoop(self._robot, limits, self._period, lambda: False)
            motion = ramp(target, spec.NOMINAL_POSE, limits.slow_speed, self._period, hold=0.3)
            self._robot.gate.slow = True
            self._last = loop.play(motion, Mode.RAMP)
            self._robot.gate.slow = False
        except RobotFault as fault:
            self._give_up(fault)
            raise
        self._deadline = time.monotonic() + self._period
        return self._state()

    def step(self, position_target: np.ndarray) -> BackendState:
        """Send (12,) targets [rad] and wait out the control period.

        The gate may slow a target down or bring it inside the limits. A fault makes the robot idle and is told in
        the state.
        """
        try:
            self._robot.send(position_target, Mode.WALK)
            self._robot.listen(self._deadline)
            self._last = self._robot.check()
        except RobotFault as fault:
            self._give_up(fault)
        self._deadline = max(self._deadline + self._period, time.monotonic())
        return self._state()

    def close(self) -> None:
        """Idle, and give the port back."""
        self._robot.close()

    def _give_up(self, fault: RobotFault) -> None:
        self.fault, self._armed = self.fault or fault, False
        self._robot.idle()

    def _state(self) -> BackendState:
        assert self._last is not None, "reset comes first"
        telemetry, target = self._last.telemetry, self._robot.target
        torque = np.zeros(spec.NUM_JOINTS)
        if telemetry.cur is not None:
            torque = spec.TORQUE_CONSTANT * telemetry.cur
        elif target is not None:
            gains = self._gains
            current = servo_current(target, telemetry.pos, telemetry.vel, gains.kp, gains.kd, gains.max_current)
            torque = spec.TORQUE_CONSTANT * current
        return backend_state(telemetry, torque, 0 if self.fault is None else FAULT)
