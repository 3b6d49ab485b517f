"""What an armed robot plays: a walk with a trained policy, or given targets."""

import time
from contextlib import AbstractContextManager

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.control_loop import AfterStep, ControlLoop, Motion
from motorprior.hardware.health import Measurement
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.hardware.session import Session, check_before_arming
from motorprior.hardware.teleop import Print, Teleop
from motorprior.locomotion.control_step import (
    begin_gait,
    command_step,
    follow_command,
    new_gait,
    write_readings,
)
from motorprior.locomotion.gait import YAW_RATE, action_size, walker_arrays
from motorprior.locomotion.policy import Policy, act
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.robots.robot import Robot

# maximum relative difference of a policy's gains, which come from a fit, from the robot's
_GAIN_TOLERANCE = 0.15
_STATUS_PERIOD = 50  # control steps between two lines of status
# Time to slow down before the crouch [s]. Of 36 simulated walks that crouched at once from full
# speed, 11 tilted beyond 0.5 rad; with this time, none did.
_STOPPING_TIME = 1.0


class PolicyMotion:
    """A walking policy as a motion, with the same `locomotion.control_step` as in simulation.

    Without an IMU the policy acts as if the robot were upright and turned as commanded.
    """

    def __init__(self, robot: Robot, policy: Policy, has_imu: bool = True):
        self._policy = policy.arrays
        self._has_imu = has_imu
        self._walker = walker_arrays(robot.with_speed_range(policy.forward))
        self.gait = new_gait(self._walker)
        self._action = np.zeros(action_size(robot.num_joints))
        self.forward = 0.0  # commanded speed [m/s]
        self.yaw_rate = 0.0  # commanded yaw rate, to the left [rad/s]
        # (3,) gyroscope rates measured at rest [rad/s]; subtracted, or the heading would drift
        self.gyro_bias = np.zeros(3)

    def __call__(self, measurement: Measurement) -> np.ndarray:
        """The (joints,) targets [rad] for a measurement: observe, act, command."""
        gait = self.gait
        telemetry = measurement.telemetry
        rates = np.array(telemetry.rates) - self.gyro_bias
        write_readings(
            self._walker, telemetry.roll, telemetry.pitch, rates, telemetry.pos, gait.observation
        )
        if not self._has_imu:  # the policy would steer against a measured yaw rate of 0
            gait.observation[YAW_RATE] = gait.velocity_command[1]
        follow_command(self._walker, gait, self.forward, self.yaw_rate)
        act(self._policy, gait.observation, self._action)
        command_step(self._walker, gait, self._action)
        return gait.target.copy()

    def slow_down(self) -> Motion:
        """The motion that slows the walk down to stepping in place, for _STOPPING_TIME."""
        steps = iter(range(round(_STOPPING_TIME / self._walker.control_dt)))

        def target(measurement: Measurement) -> np.ndarray | None:
            self.forward = 0.0
            self.yaw_rate = 0.0
            return None if next(steps, None) is None else self(measurement)

        return target

    def warm_up(self, measurement: Measurement) -> None:
        """Compile, or load compiled code, and reset."""
        self(measurement)
        begin_gait(self._walker, self.gait)


def gains_for(
    robot: Robot,
    policy: Policy,
    kp: float | None = None,
    kd: float | None = None,
    max_current: float | None = None,
) -> Gains:
    """The gains to send for a policy: the given ones [A/rad, A·s/rad, A], or the robot's own.

    Raises ConfigError for gains out of range. If a gain is not given, raises ConfigError if the
    gain of the policy's training differs by more than 15 % from the robot's.
    """
    wire = robot.require_wire()
    if kp is None:
        kp_of_training = policy.kp / wire.torque_constant
        _require_gain_of_training("kp", "A/rad", kp_of_training, wire.kp, wire.safety.max_kp)
    if kd is None:
        kd_of_training = policy.kd / wire.torque_constant
        _require_gain_of_training("kd", "A·s/rad", kd_of_training, wire.kd, wire.safety.max_kd)
    return Gains.of(wire, kp, kd, max_current)


def _require_gain_of_training(
    name: str, unit: str, gain_of_training: np.ndarray, gain: float, max_gain: float
) -> None:
    """Raise ConfigError if the robot's gain differs from the (joints,) gain of the training."""
    if np.abs(gain_of_training / gain - 1.0).max() <= _GAIN_TOLERANCE:
        return
    mean = float(gain_of_training.mean())
    remedy = "train it with the robot's gains"
    if mean <= max_gain:
        remedy = f"give {name} {mean:.1f} if that is intended, or {remedy}"
    raise ConfigError(
        f"the policy was trained with {name} = {mean:.1f} {unit} on its motors, "
        f"the robot has {gain:g}",
        remedy=remedy,
        argument=name,
    )


def walk(
    session: Session,
    policy: Policy,
    steering: AbstractContextManager[Teleop],
    seconds: float | None = None,
) -> None:
    """Check an idle robot, arm it, stand up, walk as ``steering`` commands, crouch.

    It walks for ``seconds`` [s] or until the session is stopped. The status is a line twice a
    second. Raises RobotFault if a fault ended the walk early; the robot is idle.
    """
    motion = PolicyMotion(session.link.robot, policy, session.need_imu)
    motion.gyro_bias = session.check(motion.warm_up)

    def work(loop: ControlLoop) -> None:
        end = time.monotonic() + seconds if seconds is not None else float("inf")

        def steered(measurement: Measurement) -> np.ndarray | None:
            command = operator.command()
            if command is None or time.monotonic() >= end:
                session.outcome = "operator" if command is None else "time"
                return None
            motion.forward, motion.yaw_rate = command
            return motion(measurement)

        show_status = _status_line(session.link, motion, session.status)
        with steering as operator:
            loop.run_motion(steered, Mode.WALK, show_status, session.timing)

    session.run(work, slow_down=motion.slow_down)


def dry_run(session: Session, policy: Policy, command: tuple[float, float], seconds: float) -> int:
    """Compute a walk from an idle robot's telemetry for ``seconds`` [s], and send nothing.

    ``command`` is speed [m/s] and yaw rate [rad/s]. Returns the number of control steps. Raises
    RobotFault as `walk`.
    """
    link = session.link
    motion = PolicyMotion(link.robot, policy, session.need_imu)
    measurement, motion.gyro_bias = check_before_arming(link, need_imu=False)
    motion.warm_up(measurement)
    motion.forward, motion.yaw_rate = command
    show_status = _status_line(link, motion, session.status)

    steps = 0
    deadline = time.monotonic()
    end = deadline + seconds
    while deadline < end and not session.stop_signals:
        deadline += policy.control_dt
        link.receive(deadline)
        measurement = link.check()
        target = motion(measurement)
        if not np.all(np.isfinite(target)):
            raise RobotFault("impossible command", f"the policy's targets are {target.tolist()}")
        steps += 1
        show_status(steps, measurement)
    return steps


def _status_line(link: RobotLink, motion: PolicyMotion, status: Print) -> AfterStep:
    """Shows time, attitude, command and the state of the telemetry every half second."""

    def show(count: int, measurement: Measurement) -> None:
        if count % _STATUS_PERIOD:
            return
        telemetry = measurement.telemetry
        age = 1e3 * (time.monotonic() - measurement.sampled)
        damaged = link.port.reader.rejected + link.stream.impossible
        status(
            f"{link.robot.control_dt * count:6.1f} s  "
            f"roll {telemetry.roll:+.2f} pitch {telemetry.pitch:+.2f} rad  "
            f"command {motion.forward:+.2f} m/s {motion.yaw_rate:+.1f} rad/s  "
            f"telemetry {age:.0f} ms old, damaged {damaged}"
        )

    return show


def excite(session: Session, targets: np.ndarray, suspended: bool) -> None:
    """Check, arm, ramp to the nominal pose, and play (steps, joints) ``targets`` [rad].

    At the end the current is removed; a robot that is not ``suspended`` crouches first. The status
    is a line every five seconds. Raises RobotFault as `walk`.
    """
    session.check()
    period = session.link.robot.control_dt
    rows = iter(targets)

    def show(count: int, _: Measurement) -> None:
        if count % (10 * _STATUS_PERIOD) == 0:
            session.status(f"{count * period:6.1f} of {len(targets) * period:g} s recorded")

    def work(loop: ControlLoop) -> None:
        loop.run_motion(lambda _: next(rows, None), Mode.EXCITE, show, session.timing)

    session.run(work, crouch=not suspended)
