"""Motions, step by step: a ramp, a policy, an excitation. A motion ends by returning None."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from motorprior.backend import BackendState
from motorprior.hardware.axes import backend_state
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion.body import action_size, body_of, observation_size
from motorprior.locomotion.control_step import command_step
from motorprior.locomotion.policy import INTENSITY, Policy, act
from motorprior.locomotion.task import observe
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
    """A policy in the loop, with the very functions of the simulation, in the order of `WalkEnv`.

    Attributes:
        observation: (observations,) the last input of the policy.
        throttle: 0..1, share of the intensity that the policy asks for. 1 is the policy as it was trained; it was not
            trained for another.
    """

    def __init__(self, robot: Robot, policy: Policy):
        joints = robot.num_joints
        self._robot, self._body, self._policy = robot, body_of(robot), policy
        self.throttle = 1.0
        self.observation, self._action = np.zeros(observation_size(joints)), np.zeros(action_size(joints))
        self._command, self._target = np.zeros(action_size(joints)), np.zeros(joints)
        self.reset()

    def reset(self) -> None:
        """Begin an episode: phase and filter at 0."""
        self._phase, self._filter_state = 0.0, np.zeros(len(self._action))

    def step(self, state: BackendState) -> np.ndarray:
        """The (joints,) targets [rad] for a state: observe, act, command; afterwards the phase is the next one."""
        policy = self._policy
        observe(
            state.base_quat,
            state.base_ang_vel,
            state.measured_joint_pos,
            self._phase,
            self._body.nominal_pose,
            self.observation,
        )
        act(policy.weights, policy.observation_mean, policy.observation_std, self.observation, self._action)
        if self.throttle < 1.0:  # intensity = (action + 1) / 2, so this scales it
            intensity = self._robot.num_joints + INTENSITY
            self._action[intensity] = self.throttle * (self._action[intensity] + 1.0) - 1.0
        self._phase = command_step(
            self._body, self._action, self._filter_state, self._phase, policy.control_dt, self._command, self._target
        )
        return self._target.copy()

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
        """Compile, or load what was compiled, before time counts; then forget it."""
        self(measurement)
        self.reset()
