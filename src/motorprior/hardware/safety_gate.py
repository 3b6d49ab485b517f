"""The safety gate: every command to the robot passes through it.

A target that is too far or too fast is clipped and counted; an invalid target ends the motion.
After a fault only the idle command passes and, if the fault leaves time for it, the targets of the
crouch.
"""

from dataclasses import asdict, dataclass

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import IDLE, Command
from motorprior.robots.robot import Robot, SafetyLimits, Wire


@dataclass(frozen=True)
class Gains:
    """Gains and current limit of the motors."""

    kp: float  # [A/rad]
    kd: float  # [A·s/rad]
    max_current: float  # [A]

    @classmethod
    def of(
        cls,
        wire: Wire,
        kp: float | None = None,
        kd: float | None = None,
        max_current: float | None = None,
    ) -> "Gains":
        """The given gains, and the robot's own in place of None; raises ConfigError as `check`."""
        gains = cls(
            kp=wire.kp if kp is None else kp,
            kd=wire.kd if kd is None else kd,
            max_current=wire.max_current if max_current is None else max_current,
        )
        gains.check(wire.safety)
        return gains

    def check(self, limits: SafetyLimits) -> None:
        """Raise ConfigError unless every value is positive and within the limits."""
        require_number("kp", self.kp, 0.0, limits.max_kp, positive=True)
        require_number("kd", self.kd, 0.0, limits.max_kd, positive=True)
        require_number("max_current", self.max_current, 0.0, limits.max_current, positive=True)


class TargetGate:
    """Limits of position and slew rate.

    Args:
        lower: (joints,) lower limits [rad].
        upper: (joints,) upper limits [rad].
        period: control period [s]. A late step may make up for at most two periods, since a target
            must not jump after a pause.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, period: float):
        self._lower = lower
        self._upper = upper
        self._max_step = 2.0 * period
        self._time = 0.0
        self.target: np.ndarray | None = None  # (joints,) in force [rad]
        self.position_clips = 0  # joint targets clipped to the joint limits
        self.slew_clips = 0  # joint targets slowed down

    def begin(self, joint_pos: np.ndarray, now: float) -> None:
        """Begin at the present (joints,) positions [rad], so that the first target is no jump."""
        self.target = np.clip(joint_pos, self._lower, self._upper)
        self._time = now

    def limited(self, target: np.ndarray, now: float, speed: float) -> np.ndarray:
        """The new target in force for (joints,) targets [rad], at most ``speed`` [rad/s] fast.

        Raises RobotFault for targets that are not finite, or before `begin`.
        """
        if self.target is None:
            raise RobotFault("not armed", "a target for a robot that is idle")
        target = np.asarray(target, dtype=np.float64)
        if target.shape != self._lower.shape or not np.all(np.isfinite(target)):
            problem = f"target {target.tolist()} is not {len(self._lower)} finite angles"
            raise RobotFault("impossible command", problem, safe_state="crouch")

        inside = np.clip(target, self._lower, self._upper)
        self.position_clips += int(np.count_nonzero(inside != target))
        reach = speed * min(max(0.0, now - self._time), self._max_step)
        reachable = np.clip(inside, self.target - reach, self.target + reach)
        self.slew_clips += int(np.count_nonzero(reachable != inside))
        self.target = reachable
        self._time = now
        return reachable


class SafetyGate:
    """Limits of position, slew rate, gains and current."""

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._signs = robot.require_wire().joint_signs
        self._limits = limits
        self._targets = TargetGate(robot.lower, robot.upper, robot.control_dt)
        self._fault: RobotFault | None = None
        self._crouching = False
        self.slow = False  # limit targets to ``slow_speed``: while standing up and crouching
        # joint targets slowed down while not ``slow``: ramps keep to ``slow_speed`` themselves
        self.slew_clips = 0
        # with the current limit; some firmwares ignore them in a command with ``pos``
        self.gains = Command()

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target in force [rad], None while idle."""
        target = self._targets.target
        return None if target is None else target.copy()

    @property
    def position_clips(self) -> int:
        """Joint targets clipped to the joint limits."""
        return self._targets.position_clips

    def arm(self, gains: Gains, joint_pos: np.ndarray, now: float) -> None:
        """Begin at the present (joints,) positions [rad], so that the first target is no jump."""
        gains.check(self._limits)
        if self._fault is not None:
            raise self._fault
        self.gains = Command(**asdict(gains))
        self._targets.begin(joint_pos, now)

    def limited(self, target: np.ndarray, now: float) -> Command:
        """The command for (joints,) position targets [rad], clipped to the limits.

        Raises RobotFault after a fault, without `arm`, or for targets that are not finite.
        """
        if self._fault is not None and not self._crouching:
            raise self._fault
        speed = self._limits.slow_speed if self.slow else self._limits.target_speed
        clips = self._targets.slew_clips
        try:
            reachable = self._targets.limited(target, now, speed)
        except RobotFault as fault:
            raise self.latch_fault(fault) from None
        if not self.slow:
            self.slew_clips += self._targets.slew_clips - clips
        return Command(pos=self._signs * reachable)

    def latch_fault(self, fault: RobotFault) -> RobotFault:
        """Let only idle pass from now on; returns the first fault, which stays in force."""
        self._fault = self._fault or fault
        self._crouching = False
        return self._fault

    def allow_crouch(self) -> None:
        """Let the motion into the crouch pass, unless the fault requires idle."""
        self._crouching = self._fault is None or self._fault.safe_state == "crouch"

    def idle(self) -> Command:
        """No current; always allowed."""
        self._targets.target = None
        self._crouching = False
        return IDLE
