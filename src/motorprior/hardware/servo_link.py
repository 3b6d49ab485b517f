"""The host's link to servos on a bus: scan, safety, control steps, recording.

All angles are of the robot's joints:

    count = zero + sign·angle·counts per turn/(2π)
"""

import contextlib
import math
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.buses.bus import Clock, NoAnswer, Readings, ServoBus, ServoInfo
from motorprior.hardware.health import SlowHost, TrackingFaults
from motorprior.hardware.safety_gate import TargetGate
from motorprior.hardware.servo_recorder import ServoRecorder
from motorprior.hardware.watchdog import Watchdog
from motorprior.logs.readers.deploy_recording import Mode
from motorprior.robots.servos import ServoChain

_TURN = 2.0 * math.pi
_RATE_SAMPLES = 50  # readings that measure the rate of the bus
# the control period is this multiple of the longest reading but one: it has a write, too
_PERIOD_MARGIN = 1.5
_MAX_BUS_RATE = 1000.0  # [Hz]
_JUMP_SLACK = 0.05  # allowed motion in addition to speed times time [rad]


@dataclass(frozen=True)
class ServoLimits:
    """Limits of the host's gate and fault detection."""

    target_speed: float = 12.0  # of targets [rad/s]
    slow_speed: float = 0.5  # while ramping [rad/s]
    # the torque limit until the first motion has followed, as a share of the limit in the register
    first_torque: float = 0.4
    first_motion: float = 0.06  # [rad]
    first_error: float = 0.5  # largest error at its end, as a share of the first motion [-]
    sinking_torque: float = 0.15  # share of the torque with which a robot sinks after a fault [-]
    sinking_time: float = 1.0  # [s]
    # a joint's error against its target with a first-order lag of ``lag`` [s]
    lag: float = 0.1
    tracking_error: float = 0.6  # [rad]
    tracking_time: float = 0.4  # [s]
    stuck_motion: float = 0.004  # [rad]
    stuck_target: float = 0.15  # [rad]
    stuck_time: float = 0.8  # [s]
    temperature_margin: float = 10.0  # below the servo's own limit [K]
    voltage_drop: float = 0.15  # share of the voltage before the motion [-]
    voltage_time: float = 0.1  # [s]
    silence: float = 0.2  # time without a complete answer [s]
    joint_speed: float = 30.0  # largest plausible [rad/s]
    implausible_readings: int = 3  # so many in a row are a fault
    # lateness of control steps [s], see `health.SlowHost`
    tick_delay: float = 0.1
    late_ticks: int = 30
    stalled_time: float = 0.3
    watchdog: float = 0.2  # the host is silent [s]
    # the bus is silent [s]: neither the host nor its watchdog reaches the servos
    bus_watchdog: float = 0.5


@dataclass(frozen=True)
class ChainJoints:
    """Joints of a robot and their servos."""

    names: tuple[str, ...]
    lower: np.ndarray  # (n,) [rad]
    upper: np.ndarray  # (n,) [rad]
    chain: ServoChain
    counts: int  # per turn of the servos' encoders

    def pos(self, count: np.ndarray) -> np.ndarray:
        """(n,) joint angles [rad] of (n,) encoder counts."""
        return self._signs * (count - np.array(self.chain.zeros)) * _TURN / self.counts

    def count(self, pos: np.ndarray) -> np.ndarray:
        """(n,) encoder counts of (n,) joint angles [rad], not rounded."""
        return np.array(self.chain.zeros) + self._signs * pos * self.counts / _TURN

    def vel(self, speed: np.ndarray) -> np.ndarray:
        """(n,) joint speeds of (n,) speeds of the servos [rad/s]."""
        return self._signs * speed

    @property
    def _signs(self) -> np.ndarray:
        return np.array(self.chain.signs, dtype=np.float64)

    def within(self, infos: Sequence[ServoInfo]) -> "ChainJoints":
        """The joints with the position limits of their servos."""
        ends = np.array([info.position_limits for info in infos], dtype=np.float64)
        # Feetech: both 0 in multi-turn mode
        unlimited = ends[:, 0] >= ends[:, 1]
        angles = np.sort([self.pos(ends[:, 0]), self.pos(ends[:, 1])], axis=0)
        lower = np.where(unlimited, self.lower, np.maximum(self.lower, angles[0]))
        upper = np.where(unlimited, self.upper, np.minimum(self.upper, angles[1]))
        return ChainJoints(self.names, lower, upper, self.chain, self.counts)


def scanned(bus: ServoBus, chain: ServoChain) -> list[ServoInfo]:
    """What the servos of a chain state; the bus then addresses them.

    Raises RobotFault if one does not answer, has torque or reports a condition.
    """
    infos = bus.scan(chain.ids)
    require_ready(infos, chain)
    bus.ids = tuple(chain.ids)
    for info in infos:
        if info.torque_on:
            raise RobotFault(
                "torque on",
                f"servo {info.id} holds its position",
                remedy="put the robot where it rests by itself, and switch its power off and on, "
                "or use motorprior doctor --idle with the same --robot or --motor",
            )
    return infos


def require_ready(infos: Sequence[ServoInfo], chain: ServoChain) -> None:
    """Raise RobotFault if a servo of a chain does not answer or reports a condition."""
    missing = sorted(set(chain.ids) - {info.id for info in infos})
    if missing:
        raise RobotFault(
            "silence",
            f"no answer from servo {', '.join(map(str, missing))}",
            remedy="check power, cable, ids and --baud-rate",
        )
    for info in infos:
        if info.conditions:
            raise RobotFault(
                info.conditions[0],
                f"servo {info.id} reports {', '.join(info.conditions)}",
                remedy="remove the cause, and switch the power off and on",
            )


class ServoLink:
    """A host's link to the servos of one robot, without torque until `arm`.

    Args:
        bus: the open bus, which addresses the servos.
        joints: the robot's joints, within the servos' own limits.
        infos: what the servos state.
        clock: the time of the bus.
        limits: of gate and checks.
        recorder: gets the readings.
        watch: start a watchdog process when armed; needs the port's real file.
    """

    def __init__(
        self,
        bus: ServoBus,
        joints: ChainJoints,
        infos: Sequence[ServoInfo],
        clock: Clock,
        limits: ServoLimits,
        recorder: ServoRecorder,
        watch: str | None = None,
    ):
        self.bus = bus
        self.joints = joints
        self.infos = list(infos)
        self.clock = clock
        self.limits = limits
        self.period = 0.01
        self.rate_of_bus = 0.0  # readings of all servos per second
        self._recorder = recorder
        self._watch = watch
        self._watchdog: Watchdog | None = None
        self._file: int | None = None
        if watch is not None:
            # opened before the bus is armed; the watchdog inherits it
            self._file = os.open(watch, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._has_written = False  # to a register of a servo
        self._gate = TargetGate(joints.lower, joints.upper, self.period)
        self._tracking = TrackingFaults(joints.names, limits, limits.lag)
        self._slow_host = SlowHost(limits, self.period)
        self._deadline = 0.0
        self._last: Readings | None = None  # last plausible reading
        self._implausible = 0  # readings in a row
        self._target_since = 0.0  # time at which the target in force was written [s]
        self._low_voltage_since = math.inf
        self._rest_voltage = np.array([info.voltage for info in infos])
        self.lost = 0  # exchanges without a complete answer
        self._errors: deque[str] = deque(maxlen=3)

    def measure_rate(self, max_rate: float) -> None:
        """Measure how fast the bus is, without moving, and set the control period."""
        seconds = []
        for _ in range(_RATE_SAMPLES):
            with contextlib.suppress(NoAnswer):
                self._last = self.bus.read()
                seconds.append(self._last.end - self._last.begin)
        if self._last is None:
            raise self._silence()
        exchange = sorted(seconds)[-2:][0]
        self.rate_of_bus = 1.0 / exchange
        rate = min(self.rate_of_bus / _PERIOD_MARGIN, max_rate, _MAX_BUS_RATE)
        self.period = 1.0 / rate
        self._gate = TargetGate(self.joints.lower, self.joints.upper, self.period)
        self._slow_host = SlowHost(self.limits, self.period)

    @property
    def pos(self) -> np.ndarray:
        """(n,) joint angles of the last reading [rad]."""
        assert self._last is not None
        return self.joints.pos(self._last.counts)

    @property
    def target(self) -> np.ndarray:
        """(n,) target in force [rad]."""
        assert self._gate.target is not None
        return self._gate.target

    def arm(self) -> None:
        """Switch the torque on, at the present position and with a low limit.

        Raises RobotFault for a moving joint or one outside its limits.
        """
        before = self.pos
        self.clock.wait_until(self.clock.clock() + 0.1)
        self._last = self.bus.read()
        self._require_static(before)
        if self._file is not None:
            frame = self.bus.release_frame(self.infos)
            self._watchdog = Watchdog(self._file, self.limits.watchdog, frame)

        # first, since a servo that an earlier silence has stopped ignores limits and goals
        self._set_bus_watchdog(self.limits.bus_watchdog)
        self._limit_torque(self.limits.first_torque)
        self.bus.write_goals(self._last.counts)
        self.bus.set_torque(True)
        now = self.clock.clock()
        self._gate.begin(self.pos, now)
        self._target_since = now
        self._tracking.begin(self.limits.lag)
        self._deadline = now + self.period

    def _require_static(self, before: np.ndarray) -> None:
        motion = np.abs(self.pos - before)
        joint = int(np.argmax(motion))
        if motion[joint] > 0.02:
            raise RobotFault(
                "moving",
                f"{self.joints.names[joint]} moved {motion[joint]:.2f} rad without torque",
                remedy="put the robot where it rests by itself",
            )
        slack = 0.1  # end stops are soft
        outside = (self.pos < self.joints.lower - slack) | (self.pos > self.joints.upper + slack)
        if outside.any():
            joint = int(np.argmax(outside))
            raise RobotFault(
                "position",
                f"{self.joints.names[joint]} is at {self.pos[joint]:+.2f} rad, outside "
                f"{self.joints.lower[joint]:+.2f} to {self.joints.upper[joint]:+.2f}",
                remedy="check signs and zeros of [servos], and the calibration",
            )

    def _limit_torque(self, share: float) -> None:
        """Limit the torque to a share of the limits found in the registers."""
        self._has_written = True
        self.bus.set_torque_limit(share * np.array([info.torque_limit for info in self.infos]))

    def _set_bus_watchdog(self, seconds: float) -> None:
        """Let servos stop when the bus is silent, 0: off.

        Servos with a homing offset are left out: firmware of 2022 moves them away when it stops
        them (ROBOTIS-GIT/DynamixelSDK, issue 584).
        """
        self._has_written = True
        is_direct = np.array([info.offset == 0 for info in self.infos])
        self.bus.set_bus_watchdog(seconds * is_direct)

    def allow_full_torque(self) -> None:
        """Restore the torque limits that were found in the registers."""
        self._limit_torque(1.0)

    def step(self, target: np.ndarray, mode: Mode, part: int, speed: float) -> None:
        """Wait for the next control step, read, check, record, and write (n,) targets [rad].

        Raises RobotFault for the first fault. A slow host and hot servos do not end the return to
        rest (``Mode.CROUCH``), which they cause.
        """
        returns = mode is Mode.CROUCH
        self.clock.wait_until(self._deadline)
        late = self.clock.clock() - self._deadline
        if not returns:
            self._slow_host.check(late)
        self._deadline += self.period * max(1, math.ceil(late / self.period))
        if self._watchdog is not None:
            self._watchdog.beat()

        reading = self._read()
        if reading is None:  # waiting for an answer is no delay of the host
            self._deadline = self.clock.clock() + self.period
        else:
            self._check(reading, returns)
            self._recorder.write(reading, self.joints, self.target, self._target_since, mode, part)

        reachable = self._gate.limited(target, self.clock.clock(), speed)
        counts = np.rint(self.joints.count(reachable))
        try:
            self.bus.write_goals(counts)
        except NoAnswer as error:
            self._errors.append(str(error))
            return
        self._gate.target = self.joints.pos(counts)  # as sent
        self._target_since = self.clock.clock()

    def _read(self) -> Readings | None:
        """A plausible reading, or None; raises RobotFault after a silence."""
        assert self._last is not None
        try:
            reading = self.bus.read()
        except NoAnswer as error:
            self.lost += 1
            self._errors.append(str(error))
            if self.clock.clock() - self._last.end > self.limits.silence:
                raise self._silence() from error
            return None

        step = reading.end - self._last.end
        motion = np.abs(reading.counts - self._last.counts) * _TURN / self.bus.counts
        if np.all(motion <= self.limits.joint_speed * step + _JUMP_SLACK):
            self._implausible = 0
            self._last = reading
            return reading
        self._implausible += 1
        if self._implausible >= self.limits.implausible_readings:
            joint = int(np.argmax(motion))
            raise RobotFault("encoder", f"{self.joints.names[joint]} jumped by {motion[joint]:.2f}")
        return None

    def _silence(self) -> RobotFault:
        return RobotFault(
            "silence",
            f"no complete answer for {self.limits.silence:g} s ({'; '.join(self._errors)})",
            remedy="support the robot, whose servos may hold their position, switch their power "
            "off, and check the cable",
        )

    def _check(self, reading: Readings, returns: bool) -> None:
        """Raise RobotFault for a condition, a voltage, a temperature or a tracking fault.

        A robot that returns to rest may be hot.
        """
        names = self.joints.names
        for joint, bits in enumerate(reading.conditions.tolist()):
            if bits:
                conditions = self.bus.condition_names(bits) or (f"status {bits}",)
                raise RobotFault(
                    conditions[0],
                    f"{names[joint]} reports {', '.join(conditions)}",
                    remedy="remove the cause, and switch the power off and on",
                )

        low = reading.voltage < (1.0 - self.limits.voltage_drop) * self._rest_voltage
        if not low.any():
            self._low_voltage_since = math.inf
        elif reading.end < self._low_voltage_since:
            self._low_voltage_since = reading.end
        if reading.end - self._low_voltage_since > self.limits.voltage_time:
            joint = int(np.argmax(low))
            raise RobotFault(
                "voltage",
                f"{names[joint]} has {reading.voltage[joint]:.1f} V, "
                f"{self._rest_voltage[joint]:.1f} V at rest",
                remedy="use a stronger supply, or less speed and amplitude",
            )

        ends = np.array([info.max_temperature for info in self.infos])
        hot = reading.temperature > ends - self.limits.temperature_margin
        if hot.any() and not returns:
            joint = int(np.argmax(hot))
            raise RobotFault(
                "temperature",
                f"{names[joint]} has {reading.temperature[joint]:.0f} °C, its limit is "
                f"{ends[joint]:.0f} °C",
                safe_state="crouch",
                remedy="let it cool down, and record for a shorter time",
            )

        for fault in self._tracking.faults(self.pos, self.target, reading.end):
            raise fault

    def sink(self) -> None:
        """Lower the torque limit and wait, so that the robot does not drop; never fails."""
        if not self._has_written:
            return
        with contextlib.suppress(Exception):
            self._set_bus_watchdog(0.0)
            self._limit_torque(self.limits.sinking_torque)
            end = self.clock.clock() + self.limits.sinking_time
            while self.clock.clock() < end:
                if self._watchdog is not None:
                    self._watchdog.beat()
                self.clock.wait_until(self.clock.clock() + 0.02)

    def release(self) -> None:
        """Switch the torque off and restore the registers; never fails.

        Nothing is written if nothing was written before.
        """
        sent = False
        if self._has_written:
            with contextlib.suppress(Exception):
                self.bus.set_torque(False)
                sent = True
            with contextlib.suppress(Exception):
                self._set_bus_watchdog(0.0)
                self._limit_torque(1.0)
                self.set_profile([info.profile_acceleration for info in self.infos])
            self._has_written = False
        if self._watchdog is not None:
            self._watchdog.end(idle_sent=sent)
            self._watchdog = None
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def set_profile(self, acceleration: Sequence[float]) -> None:
        """Set (n,) accelerations of the servos' profiles [rad/s²], 0: off, until `release`."""
        self._has_written = True
        speed = np.array([info.profile_speed for info in self.infos])
        self.bus.set_profile(speed, np.array(acceleration, dtype=np.float64))


def differences(infos: Sequence[ServoInfo]) -> list[str]:
    """Settings that differ between servos of a robot, each with the values per servo."""
    texts = []
    for name in ("model", "firmware", "gains", "profile_speed", "profile_acceleration",
                 "dead_zone", "torque_limit", "return_delay"):  # fmt: skip
        values = [getattr(info, name) for info in infos]
        if len(set(values)) > 1:
            pairs = (f"{info.id}: {value}" for info, value in zip(infos, values, strict=True))
            texts.append(f"{name} differs: {', '.join(pairs)}")
    return texts


def require_one_model(infos: Sequence[ServoInfo]) -> None:
    """Raise ConfigError unless all servos of a chain are of one model."""
    models = sorted({info.model for info in infos})
    if len(models) > 1:
        raise ConfigError(
            f"servos of several models: {', '.join(models)}",
            remedy="record one model at a time, with a robot file of its joints",
        )
