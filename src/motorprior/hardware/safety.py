"""The safety gate: the only way from a position target to the robot.

A target that is too far or too fast is brought into its bounds and counted; an impossible one ends the motion. After
a fault the gate is shut: it lets nothing pass but idle, and, where the fault leaves time for it, the way down to a
crouch.
"""

from __future__ import annotations

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.axes import to_wire
from motorprior.hardware.protocol import IDLE, Command
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits


class SafetyGate:
    """Position, slew, gain and current limits; every command of a host passes here.

    Attributes:
        slow: ``slow_speed`` of the limits holds instead: on the way up and down.
        position_clips: joints' targets brought inside the joint limits.
        slew_clips: joints' targets slowed down, while not slow: the ramps keep to ``slow_speed`` themselves.

    Args:
        robot: with a wire; its joint limits hold.
        limits: bounds.
        kp: [A/rad] and kd: [A·s/rad], gains to send.
        kd: see kp.
        max_current: [A] to send.

    Raises:
        RobotFault: gains or a current beyond the limits, negative or not finite.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits, kp: float, kd: float, max_current: float):
        _require_gain("kp", kp, limits.highest_kp, "A/rad")
        _require_gain("kd", kd, limits.highest_kd, "A·s/rad")
        _require_gain("max_current", max_current, limits.max_current, "A")
        self._wire, self._lower, self._upper = robot.require_wire(), robot.lower, robot.upper
        self._longest_step = 2.0 * robot.control_dt
        self._limits, self._kp, self._kd, self._max_current = limits, kp, kd, max_current
        self._target: np.ndarray | None = None
        self._time = 0.0
        self._fault: RobotFault | None = None
        self._descending = False
        self.slow = False
        self.position_clips = self.slew_clips = 0

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target that the robot holds [rad], None while idle."""
        return None if self._target is None else self._target.copy()

    def take_hold(self, joint_pos: np.ndarray, now: float) -> None:
        """Begin with the joints where they are, so that the first target cannot be a jump.

        Raises:
            RobotFault: an earlier fault shut the gate.
        """
        if self._fault is not None:
            raise self._fault
        self._target = np.clip(joint_pos, self._lower, self._upper)
        self._time = now

    def admit(self, target: np.ndarray, now: float) -> Command:
        """The command for a (joints,) position target [rad] of the library's frame, made safe.

        Raises:
            RobotFault: not one finite number per joint; no `take_hold` before; or the gate is shut.
        """
        if self._fault is not None and not self._descending:
            raise self._fault
        if self._target is None:
            raise self.shut(RobotFault("not armed", "a target for a robot that is idle"))
        wanted = np.asarray(target, dtype=np.float64)
        if wanted.shape != self._lower.shape or not np.all(np.isfinite(wanted)):
            problem = f"target {wanted.tolist()} is not {len(self._lower)} finite angles"
            raise self.shut(RobotFault("impossible command", problem, safe_state="crouch"))
        inside = np.clip(wanted, self._lower, self._upper)
        self.position_clips += int(np.count_nonzero(inside != wanted))
        # A late step may make up for at most two periods: a target must not leap after a pause.
        speed = self._limits.slow_speed if self.slow else self._limits.target_speed
        reach = speed * min(max(0.0, now - self._time), self._longest_step)
        near = np.clip(inside, self._target - reach, self._target + reach)
        self.slew_clips += 0 if self.slow else int(np.count_nonzero(near != inside))
        self._target, self._time = near, now
        return Command(pos=to_wire(self._wire, near))

    def law(self) -> Command:
        """Gains and current limit, a command of their own: some firmwares read nothing but `pos` beside it.

        Raises:
            RobotFault: the gate is shut.
        """
        if self._fault is not None and not self._descending:
            raise self._fault
        return Command(kp=self._kp, kd=self._kd, max_current=self._max_current)

    def shut(self, fault: RobotFault) -> RobotFault:
        """Shut the gate for good; the first fault is the one that stays."""
        if self._fault is None:
            self._fault = fault
        self._descending = False
        return self._fault

    def let_down(self) -> None:
        """Let the way down to a crouch pass; only after a fault that leaves time for it."""
        self._descending = self._fault is None or self._fault.safe_state == "crouch"

    def idle(self) -> Command:
        """No current; always allowed."""
        self._target = None
        self._descending = False
        return IDLE


def _require_gain(name: str, value: float, highest: float, unit: str) -> None:
    if not 0.0 < value <= highest:
        raise RobotFault("gains", f"{name} {value:g} {unit} is not in (0, {highest:g}]", remedy="use the robot's gains")
