"""Motions, one control step at a time: a ramp, a list of targets, a policy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.sign_conventions import backend_state
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion.body import YAW_RATE, action_size
from motorprior.locomotion.gait_controller import GaitController
from motorprior.locomotion.policy import Policy, act
from motorprior.robots.robot import Robot

Motion = Callable[[Measurement], np.ndarray | None]
"""From the latest measurement to the (joints,) position targets [rad] of this control step; None at its end."""
_MIN_RAMP = 0.5  # [s]


def ramp(start: np.ndarray, goal: np.ndarray, speed: float, control_dt: float, hold: float = 0.0) -> Motion:
    """From (joints,) ``start`` to ``goal`` [rad], all joints together, with a cosine profile.

    target = start + (goal - start)·(1 - cos(π t / T)) / 2, T such that no joint exceeds ``speed``.

    Args:
        start: first pose.
        goal: last pose.
        speed: limit of every target [rad/s].
        control_dt: control period [s].
        hold: time at the goal [s].
    """
    duration = max(_MIN_RAMP, 0.5 * math.pi * float(np.abs(goal - start).max()) / speed)
    moving, holding = math.ceil(duration / control_dt), round(hold / control_dt)
    step = 0

    def target(_: Measurement) -> np.ndarray | None:
        nonlocal step
        step += 1
        if step > moving + holding:
            return None
        share = 0.5 - 0.5 * math.cos(math.pi * min(1.0, step / moving))
        return start + share * (goal - start)

    return target


def played(targets: np.ndarray) -> Motion:
    """The rows of ``targets`` (steps, joints) [rad], one per control step."""
    rows = iter(targets)
    return lambda _: next(rows, None)


class PolicyMotion:
    """A walking policy as a motion, on the `GaitController` of `WalkEnv`.

    Attributes:
        forward: commanded speed [m/s].
        yaw_rate: commanded yaw rate [rad/s], to the left.
        gyro_bias: (3,) rates that the gyroscope measures at rest [rad/s]; subtracted, or the heading would drift.

    Args:
        robot: a legged one.
        policy: trained for it.
        has_imu: without one the policy acts as if the robot were upright and turned as commanded.
    """

    def __init__(self, robot: Robot, policy: Policy, has_imu: bool = True):
        self._robot, self._policy, self._has_imu = robot, policy.arrays(), has_imu
        self._controller = GaitController(robot.with_speeds(policy.forward), policy.control_dt, policy.gait)
        self._action = np.zeros(action_size(robot.num_joints))
        self.forward = self.yaw_rate = 0.0
        self.gyro_bias = np.zeros(3)

    @property
    def observation(self) -> np.ndarray:
        """(observations,) the last input of the policy."""
        return self._controller.observation

    def step(self, state: BackendState) -> np.ndarray:
        """The (joints,) targets [rad] for a state: observe, act, command."""
        self._controller.read(replace(state, base_ang_vel=state.base_ang_vel - self.gyro_bias))
        if not self._has_imu:  # the policy would steer against a measured yaw rate of 0
            self._controller.observation[YAW_RATE] = self._controller.gait.twist[1]
        act(self._policy, self._controller.follow(self.forward, self.yaw_rate), self._action)
        return self._controller.command(self._action)

    def __call__(self, measurement: Measurement) -> np.ndarray:
        """`step` as a `Motion`."""
        return self.step(backend_state(self._robot, measurement.telemetry, np.zeros(self._robot.num_joints)))

    def stopping(self, seconds: float) -> Motion:
        """Slow down and step in place, ``seconds`` in all."""
        remaining = round(seconds / self._controller.control_dt)

        def target(measurement: Measurement) -> np.ndarray | None:
            nonlocal remaining
            remaining -= 1
            self.forward = self.yaw_rate = 0.0
            return self(measurement) if remaining >= 0 else None

        return target

    def warm_up(self, measurement: Measurement) -> None:
        """Compile, or load what was compiled, and start again."""
        self(measurement)
        self._controller.reset()
