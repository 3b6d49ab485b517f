"""The walking task as a Gymnasium environment on any backend, simulated, virtual or real, and whole episodes of it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba.typed import List

from motorprior.actuator.kernels import without_refcounts
from motorprior.backend import Backend, BackendState
from motorprior.bounds import require_count, require_finite
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import action_size, body_of
from motorprior.locomotion.control_step import (
    begin_gait,
    command_step,
    complete_observation,
    evaluate_step,
    new_gait,
    observe,
)
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.scene import (
    Episode,
    Scene,
    SimulatedBackend,
    WalkConfig,
    WalkSimulator,
    begin_walk,
    complete,
    drawn_walker,
    walk_step,
)
from motorprior.simulation.world import World


def spaces(num_joints: int) -> tuple[Box, Box]:
    """Observations and actions.

    Bounds: |tilt| [rad], |rates| [rad/s], |joints| [rad], |drift| [m], |heading error| [rad], |commands|, phase.
    """
    bounds = np.array([np.pi, np.pi, 1e3, 1e3, 1e3, *[4.0 * np.pi] * num_joints, 10.0, 1.0, 10.0, 10.0, 1.0, 1.0])
    return Box(-bounds, bounds, dtype=np.float64), Box(-1.0, 1.0, (action_size(num_joints),), np.float64)


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    The backend must hold each target for the robot's control period. Without ``walk`` the sensors are perfect, on level
    ground. ``gait`` is the state of the gait.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig | None = None):
        self.observation_space, self.action_space = spaces(robot.num_joints)
        self._robot, self._backend, self._walk = robot, backend, walk or WalkConfig()
        self._body, self._weights = body_of(robot, self._walk.gait), self._walk.task.array()
        self.gait = new_gait(self._body)
        self._sensors, self._schedule = self._walk.inputs(robot, 0)
        self._steps, self._running = 0, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; without a seed the env's own generator draws one. ``options`` is unused.

        Returns the observation and the info that `step` describes; raises SimulationFault if the backend has a fault.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        state = self._backend.reset(drawn)
        if state.fault != 0:
            raise SimulationFault(f"the backend reports fault {int(state.fault)} at reset")
        self._steps, self._running = 0, True
        self._sensors, self._schedule = self._walk.inputs(self._robot, drawn)
        begin_gait(self._body, self.gait)
        observe(self._body, state, self.gait.observation)
        return self._observed(state), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step with an (actions,) action, clipped to [-1, 1].

        Returns:
            Observation, reward [m], terminated (fell or fault), truncated (time is up), and an info with fault, phase,
            command in force (2,) [m/s, rad/s], position_target and measured_joint_pos (joints,) [rad], base_pos (3,)
            [m] and base_quat (4,).
        """
        if not self._running:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        command_step(self._body, self.gait, require_finite("action", action, self.action_space.shape or ()))
        state = self._backend.step(self.gait.target.copy())
        earned, terminated = evaluate_step(self._body, self.gait, state, self._weights)
        self._steps += 1
        observation = self._observed(state) if state.fault == 0 else self.gait.observation.copy()
        truncated = not terminated and self._steps >= self._walk.episode_steps
        self._running = not (terminated or truncated)
        return observation, float(earned), bool(terminated), truncated, self._info(state)

    def close(self) -> None:
        """Close the backend."""
        self._backend.close()

    def _observed(self, state: BackendState) -> np.ndarray:
        complete_observation(self._body, self.gait, self._sensors, self._schedule, self._steps, state.base_quat)
        return self.gait.observation.copy()

    def _info(self, state: BackendState) -> dict[str, Any]:
        return {
            "fault": int(state.fault),
            "phase": self.gait.phase,
            "command": self.gait.twist.copy(),
            "position_target": self.gait.target.copy(),
            "measured_joint_pos": np.array(state.measured_joint_pos),
            "base_pos": np.array(state.base_pos),
            "base_quat": np.array(state.base_quat),
        }


def simulator_of(scene: Scene) -> WalkSimulator | BackendSimulator:
    """Simulator of whole episodes of a scene, compiled with MuJoCo."""
    if scene.walk.engine == "mujoco":
        return WalkSimulator(scene)
    return BackendSimulator(scene.robot, SimulatedBackend(scene), scene.walk)


class BackendSimulator:
    """Runs whole episodes on any backend, with the interpreter between control steps; one per thread.

    On MuJoCo the results equal those of the compiled `WalkSimulator` bit for bit.
    """

    def __init__(self, robot: Robot, backend: Backend, walk: WalkConfig):
        self._env = WalkEnv(robot, backend, walk)

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace has base poses and measured joint angles, and there is no motion."""
        observation, info = self._env.reset(seed=seed)
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        joints = len(info["measured_joint_pos"])
        action, total, steps, ended, rows = np.zeros(action_size(joints)), 0.0, 0, False, []
        while not ended:
            if trace:
                rows.append(np.concatenate([info["base_pos"], info["base_quat"], info["measured_joint_pos"]]))
            update_stats(observation, steps, mean, m2)
            act(policy, observation, action)
            observation, earned, terminated, truncated, info = self._env.step(action)
            total, steps, ended = total + earned, steps + 1, terminated or truncated
        fault, poses = info["fault"], np.array(rows).reshape(-1, 7 + joints)
        where, no_motion = np.zeros(2) if fault else info["base_pos"][:2], np.zeros((0, 6 + 2 * joints))
        return Episode(total, steps, self._env.gait.speed_errors / steps, where, fault, mean, m2, poses, no_motion)

    def close(self) -> None:
        """Close the backend."""
        self._env.close()


@njit(cache=True, nogil=True)
def _step(body, worlds, walkers, share, actions, weights, steps, out):
    """One control step of the robots in ``share``; ``out`` is (observations, rewards, over, faults, phases)."""
    observations, rewards, over, faults, phases = out
    for index in share:
        world, walker = without_refcounts(worlds[index]), without_refcounts(walkers[index])
        walker.action[:] = actions[index]
        rewards[index], over[index], faults[index] = walk_step(body, world, walker, weights)
        phases[index] = walker.gait.scalars[0]
        steps[index] += 1
        if faults[index] == 0:
            complete(body, world, walker, steps[index])
        observations[index] = walker.gait.observation


class WalkVectorEnv(VectorEnv):
    """``num_envs`` robots of a scene; the step after the end of an episode resets that robot, with reward 0.

    Observations, rewards and terminations are bit for bit those of as many `env.WalkEnv` of the scene in a
    `gymnasium.vector.SyncVectorEnv`, on any number of threads. Infos: fault, phase and base_pos.

    Raises:
        ConfigError: another engine than MuJoCo, or a number out of range.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, scene: Scene, num_envs: int, threads: int = 1):
        require_count("num_envs", num_envs)
        require_count("threads", threads)
        if scene.walk.engine != "mujoco":
            remedy = 'use vectorization_mode="async"'
            raise ConfigError(f"vector environments are for MuJoCo, not {scene.walk.engine!r}", remedy=remedy)
        self.num_envs, self._scene, self._body = num_envs, scene, body_of(scene.robot, scene.walk.gait)
        self.single_observation_space, self.single_action_space = spaces(scene.robot.num_joints)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._worlds = [World(scene.robot, scene.physics_dt) for _ in range(num_envs)]
        self._rngs, self._weights = [seeding.np_random(None)[0] for _ in range(num_envs)], scene.walk.task.array()
        self._pool, self._threads, self._begun = ThreadPoolExecutor(threads), threads, False
        self._steps, self._over = np.zeros(num_envs, np.int64), np.zeros(num_envs, bool)
        self._observations, self._faults = np.zeros(self.observation_space.shape or ()), np.zeros(num_envs, np.int64)
        self._rewards, self._phases = np.zeros((2, num_envs))
        walkers = [drawn_walker(scene, self._body, world, 0) for world in self._worlds]
        arrays = [world.arrays for world in self._worlds]
        self._lists: Any = (List(arrays), List(walkers))  # pyright: ignore[reportCallIssue]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin N episodes. From one seed, robot i gets seed + i; without, it uses its own generator."""
        self._begun = True
        seeds = [seed + index for index in range(self.num_envs)] if isinstance(seed, int) else seed
        for index, own in enumerate(seeds or [None] * self.num_envs):
            if own is not None:
                self._rngs[index] = seeding.np_random(own)[0]
            self._begin(index, own)
        return self._observations.copy(), self._info()

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every robot by one control step, or reset it if its episode is over; (N, actions) clip to [-1, 1].

        Raises:
            ConfigError: no reset before; actions of another shape, or not finite.
        """
        if not self._begun:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        actions = require_finite("actions", actions, self.action_space.shape or ())
        resting = self._over.copy()
        running, terminated = np.flatnonzero(~resting), np.zeros(self.num_envs, bool)
        out = (self._observations, self._rewards, terminated, self._faults, self._phases)
        shares = [np.ascontiguousarray(running[first :: self._threads]) for first in range(self._threads)]

        def step(share: np.ndarray) -> None:
            worlds, walkers = self._lists
            _step(self._body, worlds, walkers, share, actions, self._weights, self._steps, out)

        list(self._pool.map(step, shares))
        for index in np.flatnonzero(resting):
            self._begin(int(index), None)
            self._rewards[index] = 0.0
        truncated = ~terminated & ~resting & (self._steps >= self._scene.walk.episode_steps)
        self._over = terminated | truncated
        return self._observations.copy(), self._rewards.copy(), terminated, truncated, self._info()

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._pool.shutdown()

    def _begin(self, index: int, seed: int | None) -> None:
        drawn = int(self._rngs[index].integers(2**31)) if seed is None else seed
        world, (worlds, walkers) = self._worlds[index], self._lists
        walker = drawn_walker(self._scene, self._body, world, drawn)
        begin_walk(self._body, world.arrays, walker)
        worlds[index], walkers[index], self._observations[index] = world.arrays, walker, walker.gait.observation
        self._steps[index], self._phases[index], self._faults[index], self._over[index] = 0, 0.0, 0, False

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, bool)
        base = np.array([world.arrays.qpos[:3] for world in self._worlds])
        values = {"fault": self._faults.copy(), "phase": self._phases.copy(), "base_pos": base}
        return values | {f"_{name}": every for name in values}
