"""The safety gate: every command to the robot passes through it.

A target that is too far or too fast is clipped and counted; an invalid one ends the motion. After a fault the gate lets
only idle pass and, if the fault leaves time for it, the motion into the crouch.
"""

from __future__ import annotations

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.protocol import IDLE, Command
from motorprior.hardware.sign_conventions import to_wire
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits


class SafetyGate:
    """Limits of position, slew rate, gains and current.

    Attributes:
        slow: limit targets to ``slow_speed``: while standing up and crouching.
        position_clips: joint targets clipped to the joint limits.
        slew_clips: joint targets slowed down while not ``slow``: ramps keep to ``slow_speed`` themselves.

    Args:
        robot: its joint limits hold.
        limits: of speed, gains and current.
        kp: gain to send [A/rad].
        kd: gain to send [A·s/rad].
        max_current: limit to send [A].

    Raises:
        RobotFault: gains or a current limit that are not in the range of ``limits``.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits, kp: float, kd: float, max_current: float):
        _require_gain("kp", kp, limits.max_kp, "A/rad")
        _require_gain("kd", kd, limits.max_kd, "A·s/rad")
        _require_gain("max_current", max_current, limits.max_current, "A")
        self._wire, self._lower, self._upper = robot.require_wire(), robot.lower, robot.upper
        # A late step may make up for at most two periods: a target must not jump after a pause.
        self._max_step = 2.0 * robot.control_dt
        self._limits, self._kp, self._kd, self._max_current = limits, kp, kd, max_current
        self._target: np.ndarray | None = None
        self._time = 0.0
        self._fault: RobotFault | None = None
        self._crouching = False
        self.slow = False
        self.position_clips = self.slew_clips = 0

    @property
    def target(self) -> np.ndarray | None:
        """The (joints,) target that the robot holds [rad], None while idle."""
        return None if self._target is None else self._target.copy()

    def start_at(self, joint_pos: np.ndarray, now: float) -> None:
        """Begin at the present (joints,) positions [rad], so that the first target cannot be a jump.

        Raises:
            RobotFault: after an earlier fault.
        """
        if self._fault is not None:
            raise self._fault
        self._target = np.clip(joint_pos, self._lower, self._upper)
        self._time = now

    def limited(self, target: np.ndarray, now: float) -> Command:
        """The command for (joints,) position targets [rad] in the library's signs, within the limits.

        Raises:
            RobotFault: not one finite number per joint, no `start_at` before, or after a fault.
        """
        if self._fault is not None and not self._crouching:
            raise self._fault
        if self._target is None:
            raise self.latch(RobotFault("not armed", "a target for a robot that is idle"))
        wanted = np.asarray(target, dtype=np.float64)
        if wanted.shape != self._lower.shape or not np.all(np.isfinite(wanted)):
            problem = f"target {wanted.tolist()} is not {len(self._lower)} finite angles"
            raise self.latch(RobotFault("impossible command", problem, safe_state="crouch"))
        inside = np.clip(wanted, self._lower, self._upper)
        self.position_clips += int(np.count_nonzero(inside != wanted))
        speed = self._limits.slow_speed if self.slow else self._limits.target_speed
        reach = speed * min(max(0.0, now - self._time), self._max_step)
        near = np.clip(inside, self._target - reach, self._target + reach)
        self.slew_clips += 0 if self.slow else int(np.count_nonzero(near != inside))
        self._target, self._time = near, now
        return Command(pos=to_wire(self._wire, near))

    def gains(self) -> Command:
        """Gains and current limit. A command of their own: some firmwares ignore them in a command with ``pos``.

        Raises:
            RobotFault: after a fault.
        """
        if self._fault is not None and not self._crouching:
            raise self._fault
        return Command(kp=self._kp, kd=self._kd, max_current=self._max_current)

    def latch(self, fault: RobotFault) -> RobotFault:
        """Let nothing but idle pass from now on; returns the first fault, which stays."""
        if self._fault is None:
            self._fault = fault
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


def _require_gain(name: str, value: float, highest: float, unit: str) -> None:
    if not 0.0 < value <= highest:
        raise RobotFault("gains", f"{name} {value:g} {unit} is not in (0, {highest:g}]", remedy="use the robot's gains")
