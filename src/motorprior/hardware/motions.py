"""Motions, step by step: a ramp, a policy, an excitation. A motion ends by returning None."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.axes import backend_state
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion.body import action_size
from motorprior.locomotion.gait_controller import GaitController
from motorprior.locomotion.policy import INTENSITY, Policy, act
from motorprior.robots.robot import Robot

Motion = Callable[[Measurement], np.ndarray | None]
"""From the latest measurement to the (joints,) position targets [rad] of this control step; None when it is over."""
_SHORTEST_RAMP = 0.5


def ramp(start: np.ndarray, goal: np.ndarray, speed: float, control_dt: float, hold: float = 0.0) -> Motion:
    """From (joints,) ``start`` to ``goal`` [rad], all joints together, with a cosine profile.

    target = start + (goal - start)·(1 - cos(π t / T)) / 2, T such that no joint exceeds ``speed``.

    Args:
        start: where the targets begin.
        goal: where they end.
        speed: highest speed of a target [rad/s].
        control_dt: control period [s].
        hold: time to stay at the goal [s].
    """
    duration = max(_SHORTEST_RAMP, 0.5 * math.pi * float(np.abs(goal - start).max()) / speed)
    moving, staying = math.ceil(duration / control_dt), round(hold / control_dt)
    step = 0

    def target(_: Measurement) -> np.ndarray | None:
        nonlocal step
        step += 1
        if step > moving + staying:
            return None
        share = 0.5 - 0.5 * math.cos(math.pi * min(1.0, step / moving))
        return start + share * (goal - start)

    return target


def played(targets: np.ndarray) -> Motion:
    """The rows of ``targets`` (steps, joints) [rad], one per control step."""
    rows = iter(targets)
    return lambda _: next(rows, None)


class Walker:
    """A policy as a motion, on the `GaitController` of `WalkEnv`.

    Attributes:
        throttle: 0..1, share of the intensity that the policy asks for. 1 is the policy as it was trained; it was not
            trained for another.

    Args:
        robot: a legged one.
        policy: trained for it.
    """

    def __init__(self, robot: Robot, policy: Policy):
        self._robot, self._policy = robot, policy
        self._controller = GaitController(robot, policy.control_dt)
        self._action, self._intensity = np.zeros(action_size(robot.num_joints)), robot.num_joints + INTENSITY
        self.throttle = 1.0

    @property
    def observation(self) -> np.ndarray:
        """(observations,) the last input of the policy."""
        return self._controller.observation

    def step(self, state: BackendState) -> np.ndarray:
        """The (joints,) targets [rad] for a state: observe, act, command."""
        policy, action = self._policy, self._action
        observation = self._controller.observe(state)
        act(policy.weights, policy.observation_mean, policy.observation_std, observation, action)
        if self.throttle < 1.0:  # intensity = (action + 1) / 2, so this scales it
            action[self._intensity] = self.throttle * (action[self._intensity] + 1.0) - 1.0
        return self._controller.command(action)

    def __call__(self, measurement: Measurement) -> np.ndarray:
        """`step` as a `Motion`."""
        return self.step(backend_state(self._robot, measurement.telemetry, np.zeros(self._robot.num_joints)))

    def winding_down(self, seconds: float) -> Motion:
        """The same gait with less and less throttle: a third of the time is stepping in place."""
        steps, begun, step = round(seconds / self._policy.control_dt), self.throttle, 0

        def target(measurement: Measurement) -> np.ndarray | None:
            nonlocal step
            step += 1
            self.throttle = begun * max(0.0, 1.0 - 1.5 * step / steps)
            return self(measurement) if step <= steps else None

        return target

    def warm_up(self, measurement: Measurement) -> None:
        """Compile, or load what was compiled, before time counts; then begin again."""
        self(measurement)
        self._controller.reset()
