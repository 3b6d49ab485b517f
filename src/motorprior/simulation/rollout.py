"""A whole walking episode in one compiled call: policy, trajectory generator, motors, physics, reward, termination.

It calls the same compiled functions in the same order as `env.WalkEnv`, so the results are the same bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.compiled import njit
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import Body, body_of
from motorprior.locomotion.control_step import (
    GaitState,
    SensorErrors,
    begin_gait,
    command_step,
    complete_observation,
    evaluate_step,
    new_gait,
    observe,
)
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.simulation.scene import Scene
from motorprior.simulation.world import World, WorldArrays, hold_target, read_state


@dataclass(frozen=True)
class Episode:
    """Result of an episode."""

    total: float  # sum of rewards [m]
    steps: int  # control steps until the fall or the time limit
    speed_error: float  # mean over the steps of |filtered forward speed - commanded speed| [m/s]
    displacement: np.ndarray  # (2,) forward and left [m]
    fault: int  # 0 or a key of `world.FAULTS`
    mean: np.ndarray  # (observations,) mean of the observations, one per step
    m2: np.ndarray  # (observations,) Σ (x - mean)²
    trace: np.ndarray  # (steps, 7 + joints) qpos before every control step; empty if not requested
    # (steps, 6 + 2 joints) qvel before every control step, torque in the physics step before it [N·m]; empty as trace
    motion: np.ndarray


class Walker(NamedTuple):
    """A robot in an episode, without its world."""

    motors: ActuatorArrays
    sensors: SensorErrors
    schedule: np.ndarray  # (steps, 2) commanded speed [m/s] and yaw rate [rad/s]; the last row stays in force
    gait: GaitState
    action: np.ndarray  # (actions,)
    measured: np.ndarray  # (joints,) scratch: encoder readings [rad]
    feet: np.ndarray  # (legs, 3) scratch: centres of the feet [m]


def drawn_walker(scene: Scene, body: Body, world: World, seed: int) -> Walker:
    """The robot of the episode of this seed; resets the world."""
    motors, gait = scene.begin(world, seed), new_gait(body)
    measured, feet = np.zeros_like(gait.target), np.zeros((len(gait.feet), 3))
    return Walker(motors, *scene.walk.inputs(scene.robot, seed), gait, np.zeros_like(gait.command), measured, feet)


@njit(cache=True, nogil=True, inline="always")
def complete(body: Body, world: WorldArrays, walker: Walker, step: int) -> None:
    """Complete the observation of control step ``step`` after its true readings."""
    complete_observation(body, walker.gait, walker.sensors, walker.schedule, step, world.qpos[3:7])


@njit(cache=True, nogil=True, inline="always")
def begin_walk(body: Body, world: WorldArrays, walker: Walker) -> None:
    """First observation of an episode, after the world's reset."""
    begin_gait(body, walker.gait)
    observe(body, read_state(world, walker.motors, 0.0, walker.measured, walker.feet), walker.gait.observation)
    complete(body, world, walker, 0)


@njit(cache=True, nogil=True, inline="always")
def walk_step(body: Body, world: WorldArrays, walker: Walker, weights: np.ndarray) -> tuple[float, bool, int]:
    """One control step of ``walker.action``, up to the true readings; returns reward [m], end of episode, fault."""
    command_step(body, walker.gait, walker.action)
    squared = hold_target(world, walker.motors, walker.gait.target)
    state = read_state(world, walker.motors, squared, walker.measured, walker.feet)
    reward, ended = evaluate_step(body, walker.gait, state, weights)
    return reward, ended, state.fault


@njit(cache=True, nogil=True)
def _episode(body, world, walker, policy, weights, max_steps, mean, m2, trace):
    """Return total reward, steps and fault."""
    body, world, walker = without_refcounts(body), without_refcounts(world), without_refcounts(walker)
    policy, weights = without_refcounts(policy), without_refcounts(weights)
    mean, m2 = without_refcounts(mean), without_refcounts(m2)
    total, steps, fault, nq, nv = 0.0, 0, 0, world.qpos.shape[0], world.qvel.shape[0]
    begin_walk(body, world, walker)
    for step in range(max_steps):
        if trace.shape[0] > 0:
            trace[step, :nq] = world.qpos
            trace[step, nq : nq + nv] = world.qvel
            trace[step, nq + nv :] = world.torque
        update_stats(walker.gait.observation, step, mean, m2)
        act(policy, walker.gait.observation, walker.action)
        reward, ended, fault = walk_step(body, world, walker, weights)
        total += reward
        steps = step + 1
        if ended:
            break
        complete(body, world, walker, steps)
    return total, steps, fault


class WalkSimulator:
    """Runs episodes of a scene in MuJoCo; one per thread."""

    def __init__(self, scene: Scene):
        self._scene, self._body = scene, body_of(scene.robot, scene.walk.gait)
        self.world, self._weights = World(scene.robot, scene.physics_dt), scene.walk.task.array()

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """One episode of a policy of the robot; ``seed`` draws motors, conditions and commands."""
        world, steps = self.world, self._scene.walk.episode_steps
        walker = drawn_walker(self._scene, self._body, world, seed)
        mean, m2 = np.zeros_like(policy.mean), np.zeros_like(policy.mean)
        qpos, qvel, torque = world.arrays.qpos, world.arrays.qvel, world.arrays.torque
        rows = np.zeros((steps if trace else 0, len(qpos) + len(qvel) + len(torque)))
        arguments = world.arrays, walker, policy, self._weights, steps, mean, m2, rows
        total, done, fault = _episode(self._body, *arguments)
        where, speed_error = np.zeros(2) if fault else qpos[:2].copy(), walker.gait.speed_errors / done
        poses, motion = np.ascontiguousarray(rows[:done, : len(qpos)]), rows[:done, len(qpos) :]
        return Episode(total, done, speed_error, where, fault, mean, m2, poses, motion)

    def close(self) -> None:
        """Nothing to close."""
