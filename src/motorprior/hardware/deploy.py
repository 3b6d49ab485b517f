"""Walk a robot with a trained policy."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.control_loop import ControlLoop, Motion, Timing
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.session import StopRequest, check_and_confirm, check_before_arming, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.teleop import Teleop
from motorprior.hardware.wire_conversion import backend_state
from motorprior.locomotion.body import YAW_RATE, action_size, body_of
from motorprior.locomotion.control_step import begin_gait, command_step, follow_command, new_gait
from motorprior.locomotion.policy import Policy, act
from motorprior.locomotion.task import observe
from motorprior.logs.readers.robot_run import Mode
from motorprior.robots.robot import Robot

_GAIN_TOLERANCE = 0.15  # relative; a policy's gains come from a fit
_STATUS_PERIOD = 50  # control steps
# Of 36 simulated walks that crouched at once from full speed, 11 tilted beyond 0.5 rad; with this time, none.
_STOPPING_TIME = 1.0  # [s]


class PolicyMotion:
    """A walking policy as a motion, with the same `locomotion.control_step` as in simulation.

    Without an IMU the policy acts as if the robot were upright and turned as commanded.

    Attributes:
        forward: commanded speed [m/s].
        yaw_rate: commanded yaw rate [rad/s], to the left.
        gyro_bias: (3,) rates that the gyroscope measures at rest [rad/s]; subtracted, or the heading would drift.
    """

    def __init__(self, robot: Robot, policy: Policy, has_imu: bool = True):
        self._robot, self._policy, self._has_imu = robot, policy.arrays(), has_imu
        self._body = body_of(robot.with_speed_range(policy.forward), policy.gait)
        self._gait = new_gait(self._body)
        self._action = np.zeros(action_size(robot.num_joints))
        self.forward = self.yaw_rate = 0.0
        self.gyro_bias = np.zeros(3)

    @property
    def observation(self) -> np.ndarray:
        """(observations,) the last input of the policy."""
        return self._gait.observation

    def __call__(self, measurement: Measurement) -> np.ndarray:
        """The (joints,) targets [rad] for a measurement: observe, act, command."""
        state = backend_state(self._robot, measurement.telemetry, np.zeros(self._robot.num_joints))
        gait, state = self._gait, state._replace(base_ang_vel=state.base_ang_vel - self.gyro_bias)
        observe(self._body, state, gait.observation)
        if not self._has_imu:  # the policy would steer against a measured yaw rate of 0
            gait.observation[YAW_RATE] = gait.twist[1]
        follow_command(self._body, gait, self.forward, self.yaw_rate)
        act(self._policy, gait.observation, self._action)
        command_step(self._body, gait, self._action)
        return gait.target.copy()

    def stopping(self) -> Motion:
        """Slow down and step in place."""
        remaining = round(_STOPPING_TIME / self._body.control_dt)

        def target(measurement: Measurement) -> np.ndarray | None:
            nonlocal remaining
            remaining -= 1
            self.forward = self.yaw_rate = 0.0
            return self(measurement) if remaining >= 0 else None

        return target

    def warm_up(self, measurement: Measurement) -> None:
        """Compile, or load compiled code, and reset."""
        self(measurement)
        begin_gait(self._body, self._gait)


def gains_for(
    robot: Robot, policy: Policy, kp: float | None = None, kd: float | None = None, max_current: float | None = None
) -> Gains:
    """The gains to send for a policy: the given ones [A/rad, A·s/rad, A], or the robot's own.

    A policy's gains are in N·m/rad, a wire's in A/rad; the torque constant [N·m/A] converts them. If the two agree
    to 15 %, the wire's gains are sent, since the fleets were identified at these.

    Raises:
        ConfigError: the policy was trained with other gains, and none were given.
    """
    wire = robot.require_wire()
    maxima = {"kp": wire.safety.max_kp, "kd": wire.safety.max_kd}
    for name, unit, given in (("kp", "A/rad", kp), ("kd", "A·s/rad", kd)):
        trained, own = getattr(policy, name) / wire.torque_constant, getattr(wire, name)
        if given is None and np.abs(trained / own - 1.0).max() > _GAIN_TOLERANCE:
            mean, remedy = float(trained.mean()), "train it with the robot's gains"
            if mean <= maxima[name]:
                remedy = f"give {name} {mean:.1f} if that is intended, or {remedy}"
            problem = f"the policy was trained with {name} = {mean:.1f} {unit} on its motors, the robot has {own:g}"
            raise ConfigError(problem, remedy=remedy, argument=name)
    return Gains.of(wire, kp, kd, max_current)


def walk(
    link: RobotLink,
    policy: Policy,
    gains: Gains,
    stop: StopRequest,
    *,
    command: tuple[float, float] = (0.0, 0.0),
    seconds: float | None = None,
    need_imu: bool = True,
    confirm: Callable[[], None] = lambda: None,
    teleop: Callable[[], AbstractContextManager[Teleop | None]] = nullcontext,
    status: Callable[[str], None] = lambda _: None,
    timing: Timing | None = None,
) -> str:
    """Check an idle robot, arm it, stand up, walk, crouch; returns "time", "operator" or the signal that ended it.

    It walks at ``command`` (speed [m/s], yaw rate [rad/s]), or as ``teleop`` commands at every control step, for
    ``seconds`` [s] or until ``stop`` is set. A robot whose IMU is not read is rejected if ``need_imu``. ``confirm``
    raises if the user does not confirm arming. ``status`` gets a line twice a second. ``timing`` is filled also if a
    fault ends the walk.

    Raises:
        RobotFault: a fault ended the walk early; the robot is idle.
    """
    motion = PolicyMotion(link.robot, policy, need_imu)
    motion.gyro_bias = check_and_confirm(link, confirm, need_imu, motion.warm_up)
    ended_by = ""

    def work(loop: ControlLoop) -> None:
        end = time.monotonic() + seconds if seconds is not None else float("inf")

        def steered(measurement: Measurement) -> np.ndarray | None:
            nonlocal ended_by
            commanded = operator.command() if operator is not None else command
            if commanded is None or time.monotonic() >= end:
                ended_by = "operator" if commanded is None else "time"
                return None
            motion.forward, motion.yaw_rate = commanded
            return motion(measurement)

        with teleop() as operator:
            loop.play(steered, Mode.WALK, _status_line(link, motion, status), timing)

    run_armed(link, gains, stop, work, stopping=motion.stopping)
    return ended_by or stop.reason or ""


def dry_run(
    link: RobotLink,
    policy: Policy,
    stop: StopRequest,
    seconds: float,
    status: Callable[[str], None],
    command: tuple[float, float] = (0.0, 0.0),
    has_imu: bool = True,
) -> int:
    """Compute targets from an idle robot's telemetry, and send nothing; returns the number of control steps.

    Arguments and errors are those of `walk`.
    """
    motion = PolicyMotion(link.robot, policy, has_imu)
    measurement, motion.gyro_bias = check_before_arming(link, need_imu=False)
    motion.warm_up(measurement)
    motion.forward, motion.yaw_rate = command
    show, steps = _status_line(link, motion, status), 0
    deadline = time.monotonic()
    end = deadline + seconds
    while deadline < end and not stop():
        deadline += policy.control_dt
        link.receive(deadline)
        measurement = link.check()
        target = motion(measurement)
        if not np.all(np.isfinite(target)):
            raise RobotFault("impossible command", f"the policy's targets are {target.tolist()}")
        show(measurement)
        steps += 1
    return steps


def _status_line(link: RobotLink, motion: PolicyMotion, status: Callable[[str], None]) -> Callable[[Measurement], None]:
    """A function of the measurement that calls ``status`` with a line every 50 control steps."""
    count, period = 0, link.robot.control_dt

    def show(measurement: Measurement) -> None:
        nonlocal count
        count += 1
        if count % _STATUS_PERIOD:
            return
        telemetry, stream = measurement.telemetry, link.stream
        age = 1e3 * (time.monotonic() - measurement.sampled)
        battery = f", {telemetry.bat:.1f} V" if telemetry.bat is not None else ""
        status(
            f"{period * count:6.1f} s  roll {telemetry.roll:+.2f} pitch {telemetry.pitch:+.2f} rad  command "
            f"{motion.forward:+.2f} m/s {motion.yaw_rate:+.1f} rad/s  telemetry {age:.0f} ms old, damaged "
            f"{link.rejected + stream.impossible}{battery}"
        )

    return show
