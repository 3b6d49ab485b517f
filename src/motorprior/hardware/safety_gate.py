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


class SafetyGate:
    """Limits of position, slew rate, gains and current."""

    def __init__(self, robot: Robot, limits: SafetyLimits):
        self._signs = robot.require_wire().joint_signs
        self._lower = robot.lower
        self._upper = robot.upper
        self._limits = limits
        # A late step may make up for at most two periods: a target must not jump after a pause.
        self._max_step = 2.0 * robot.control_dt
        self._target: np.ndarray | None = None
        self._fault: RobotFault | None = None
        self._time = 0.0
        self._crouching = False
        self.slow = False  # limit targets to ``slow_speed``: while standing up and crouching
        self.position_clips = 0  # joint targets clipped to the joint limits
        # joint targets slowed down while not ``slow``: ramps keep to ``slow_speed`` themselves
        self.slew_clips = 0
        # with the current limit; some firmwares ignore them in a command with ``pos``
        self.gains = Command()

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target in force [rad], None while idle."""
        return None if self._target is None else self._target.copy()

    def arm(self, gains: Gains, joint_pos: np.ndarray, now: float) -> None:
        """Begin at the present (joints,) positions [rad], so that the first target is no jump."""
        gains.check(self._limits)
        if self._fault is not None:
            raise self._fault
        self.gains = Command(**asdict(gains))
        self._target = np.clip(joint_pos, self._lower, self._upper)
        self._time = now

    def limited(self, target: np.ndarray, now: float) -> Command:
        """The command for (joints,) position targets [rad], clipped to the limits.

        Raises RobotFault after a fault, without `arm`, or for targets that are not finite.
        """
        if self._fault is not None and not self._crouching:
            raise self._fault
        if self._target is None:
            raise self.latch_fault(RobotFault("not armed", "a target for a robot that is idle"))
        target = np.asarray(target, dtype=np.float64)
        if target.shape != self._lower.shape or not np.all(np.isfinite(target)):
            problem = f"target {target.tolist()} is not {len(self._lower)} finite angles"
            raise self.latch_fault(RobotFault("impossible command", problem, safe_state="crouch"))

        inside = np.clip(target, self._lower, self._upper)
        self.position_clips += int(np.count_nonzero(inside != target))

        speed = self._limits.slow_speed if self.slow else self._limits.target_speed
        reach = speed * min(max(0.0, now - self._time), self._max_step)
        reachable = np.clip(inside, self._target - reach, self._target + reach)
        if not self.slow:
            self.slew_clips += int(np.count_nonzero(reachable != inside))

        self._target = reachable
        self._time = now
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
        self._target = None
        self._crouching = False
        return IDLE
