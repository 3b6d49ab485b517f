"""An episode: its settings and engine, as a Gymnasium environment, and as one compiled call.

`WalkEnv` and that call have the same compiled functions in the same order, so the results are the
same bit for bit.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.actuator.registry import DrawMotors
from motorprior.bounds import require_array, require_count
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion import control_step
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.body import action_size, body_of
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import RobotState, SensorErrors, TaskWeights
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import FAULTS, TOO_STIFF, World, hold_target, read_state

Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class WalkConfig:
    """Settings of a walking episode; ConfigError for a number out of range, or an unknown engine."""

    episode_steps: int = 500
    """Control steps until the time limit."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    randomization: Randomization = field(default_factory=Randomization)
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors, pushes."""
    commands: Commands = field(default_factory=Commands)
    """Commanded speeds and yaw rates; they may exceed the robot's usual range."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses several cores."""

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)
        if self.engine not in ENGINES:
            raise ConfigError(
                f"engine {self.engine!r} is unknown",
                remedy=f"use one of {ENGINES}",
                argument="engine",
            )

    def inputs(self, robot: Robot, seed: int) -> tuple[SensorErrors, np.ndarray]:
        """Sensor errors and (steps, 2) commands [m/s], [rad/s] of the episode of this seed."""
        sensors = self.randomization.sensors(robot, seed, self.episode_steps)
        return sensors, self.commands.schedule(robot, seed, self.episode_steps)


@dataclass(frozen=True)
class Scene:
    """Simulation of a walking episode."""

    robot: Robot  # with legs
    # the motors of an episode, from a generator seeded by the episode's seed
    draw_motors: DrawMotors
    walk: WalkConfig = field(default_factory=WalkConfig)
    # MuJoCo's step [s]; the robot's own if not given. PyBullet's is always 1 ms
    physics_dt: float | None = None

    def world(self) -> World | BulletWorld:
        """The robot in the engine of the episode; errors as `World` and `BulletWorld`."""
        return (
            World(self.robot, self.physics_dt)
            if self.walk.engine == "mujoco"
            else BulletWorld(self.robot)
        )

    def begin(self, world: World | BulletWorld, seed: int) -> ActuatorArrays:
        """Stand in the nominal pose on the motors and in the conditions of this seed; returns the motors' arrays."""
        conditions = self.walk.randomization.conditions(self.robot, seed, self.walk.episode_steps)
        return world.reset(self.draw_motors(np.random.default_rng(seed)), conditions=conditions)


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
    # (steps, 6 + 2 joints) qvel before every control step, torque in the physics step before it
    # [N·m]; empty as trace
    motion: np.ndarray


def require_walks(episodes: Sequence[Episode], name: str) -> None:
    """Raise SimulationFault, with their number, if a walk of policy ``name`` diverged: it is no fall."""
    if faults := Counter(FAULTS[episode.fault] for episode in episodes if episode.fault):
        problem = f"{faults.total()} of {len(episodes)} walks of {name} had a simulation fault ({', '.join(faults)})"
        raise SimulationFault(f"{problem}: such walks cannot be evaluated", remedy=TOO_STIFF)


@njit(cache=True, nogil=True)
def _episode(body, world, walker, policy, weights, max_steps, mean, m2, trace):
    """Return total reward, steps and fault.

    ``walker`` are the motors' arrays, the `SensorErrors`, the commands (steps, 2), the `GaitState`,
    and scratch: action (actions,), encoder readings (joints,) [rad] and centres of the feet (legs,
    3) [m].
    """
    body = without_refcounts(body)
    world = without_refcounts(world)
    walker = without_refcounts(walker)
    policy = without_refcounts(policy)
    weights = without_refcounts(weights)
    mean = without_refcounts(mean)
    m2 = without_refcounts(m2)
    motors, sensors, schedule, gait, action, measured, feet = walker
    total = 0.0
    steps = 0
    fault = 0
    nq = world.qpos.shape[0]
    nv = world.qvel.shape[0]
    control_step.begin_gait(body, gait)
    control_step.observe(body, read_state(world, motors, 0.0, measured, feet), gait.observation)
    for step in range(max_steps):
        control_step.complete_observation(body, gait, sensors, schedule, step, world.qpos[3:7])
        if trace.shape[0] > 0:
            trace[step, :nq] = world.qpos
            trace[step, nq : nq + nv] = world.qvel
            trace[step, nq + nv :] = world.torque
        update_stats(gait.observation, step, mean, m2)
        act(policy, gait.observation, action)
        control_step.command_step(body, gait, action)
        squared = hold_target(world, motors, gait.target)
        state = read_state(world, motors, squared, measured, feet)
        reward, ended = control_step.evaluate_step(body, gait, state, weights)
        total = total + reward
        steps = step + 1
        fault = state.fault
        if ended:
            break
    return total, steps, fault


class WalkSimulator:
    """Runs episodes of a scene in MuJoCo; one per thread."""

    def __init__(self, scene: Scene):
        self._scene = scene
        self._body = body_of(scene.robot)
        self.world = World(scene.robot, scene.physics_dt)
        self._weights = scene.walk.task.array()

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """One episode of a policy of the robot; ``seed`` draws motors, conditions and commands."""
        world = self.world
        steps = self._scene.walk.episode_steps
        motors = self._scene.begin(world, seed)
        gait = control_step.new_gait(self._body)
        inputs = self._scene.walk.inputs(self._scene.robot, seed)
        measured = np.zeros_like(gait.target)
        feet = np.zeros((len(gait.feet), 3))
        walker = motors, *inputs, gait, np.zeros_like(gait.command), measured, feet
        mean = np.zeros_like(policy.mean)
        m2 = np.zeros_like(policy.mean)
        qpos = world.arrays.qpos
        qvel = world.arrays.qvel
        torque = world.arrays.torque
        rows = np.zeros((steps if trace else 0, len(qpos) + len(qvel) + len(torque)))
        arguments = world.arrays, walker, policy, self._weights, steps, mean, m2, rows
        total, done, fault = _episode(self._body, *arguments)
        where = np.zeros(2) if fault else qpos[:2].copy()
        speed_error = gait.speed_errors / done
        poses = np.ascontiguousarray(rows[:done, : len(qpos)])
        motion = rows[:done, len(qpos) :]
        return Episode(total, done, speed_error, where, fault, mean, m2, poses, motion)

    def close(self) -> None:
        """Nothing to close."""


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    Every episode has new motors and conditions. ``gait`` is the state of the gait, ``world`` the
    simulated robot, in either engine. A real robot is not behind this interface: its control step
    is a deadline that depends on the age of the telemetry, and a fault in it ends in a crouch or
    without current. `hardware.motions` plays the policy instead.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, scene: Scene):
        robot = scene.robot
        joints = [4.0 * np.pi] * robot.num_joints
        # |tilt| [rad], |rates| [rad/s], |joints| [rad], |drift| [m], |heading error| [rad],
        # |commands|, phase
        bounds = np.array([np.pi, np.pi, 1e3, 1e3, 1e3, *joints, 10.0, 1.0, 10.0, 10.0, 1.0, 1.0])
        self.observation_space = Box(-bounds, bounds, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (action_size(robot.num_joints),), np.float64)
        self._scene = scene
        self.world = scene.world()
        self._body = body_of(robot)
        self._weights = scene.walk.task.array()
        self.gait = control_step.new_gait(self._body)
        self._steps = 0
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; without a seed the env's own generator draws one. ``options`` is unused.

        Returns the observation and the info that `step` describes; raises SimulationFault if the
        engine has a fault.
        """
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else int(seed)
        self._scene.begin(self.world, drawn)
        state = self.world.state()
        if state.fault != 0:
            raise SimulationFault(f"{FAULTS[state.fault]} at reset", remedy=TOO_STIFF)
        self._steps = 0
        self._running = True
        self._sensors, self._schedule = self._scene.walk.inputs(self._scene.robot, drawn)
        control_step.begin_gait(self._body, self.gait)
        control_step.observe(self._body, state, self.gait.observation)
        return self._observed(state), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step with an (actions,) action, clipped to [-1, 1].

        Returns observation, reward [m], terminated (fell or fault), truncated (time is up), and an
        info with fault, phase, command in force (2,) [m/s, rad/s], position_target and
        measured_joint_pos (joints,) [rad], base_pos (3,) [m] and base_quat (4,).
        """
        if not self._running:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        control_step.command_step(
            self._body, self.gait, require_array("action", action, self.action_space.shape or ())
        )
        state = self.world.step(self.gait.target)
        earned, terminated = control_step.evaluate_step(self._body, self.gait, state, self._weights)
        self._steps += 1
        observation = self._observed(state) if state.fault == 0 else self.gait.observation.copy()
        truncated = not terminated and self._steps >= self._scene.walk.episode_steps
        self._running = not (terminated or truncated)
        return observation, float(earned), bool(terminated), truncated, self._info(state)

    def close(self) -> None:
        """Close the engine."""
        self.world.close()

    def _observed(self, state: RobotState) -> np.ndarray:
        control_step.complete_observation(
            self._body, self.gait, self._sensors, self._schedule, self._steps, state.base_quat
        )
        return self.gait.observation.copy()

    def _info(self, state: RobotState) -> dict[str, Any]:
        return {
            "fault": int(state.fault),
            "phase": self.gait.phase,
            "command": self.gait.velocity_command.copy(),
            "position_target": self.gait.target.copy(),
            "measured_joint_pos": np.array(state.measured_joint_pos),
            "base_pos": np.array(state.base_pos),
            "base_quat": np.array(state.base_quat),
        }


def simulator_of(scene: Scene) -> "WalkSimulator | EnvSimulator":
    """Simulator of whole episodes of a scene, compiled with MuJoCo."""
    return WalkSimulator(scene) if scene.walk.engine == "mujoco" else EnvSimulator(scene)


class EnvSimulator:
    """Runs whole episodes in a `WalkEnv`; one per thread. On MuJoCo the bytes equal those of `WalkSimulator`."""

    def __init__(self, scene: Scene):
        self._env = WalkEnv(scene)

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace has base poses and measured joint angles, and there is no motion."""
        observation, info = self._env.reset(seed=seed)
        mean = np.zeros_like(policy.mean)
        m2 = np.zeros_like(policy.mean)
        joints = len(info["measured_joint_pos"])
        action = np.zeros(action_size(joints))
        total = 0.0
        steps = 0
        ended = False
        rows = []
        while not ended:
            if trace:
                rows.append(
                    np.concatenate(
                        [info["base_pos"], info["base_quat"], info["measured_joint_pos"]]
                    )
                )
            update_stats(observation, steps, mean, m2)
            act(policy, observation, action)
            observation, earned, terminated, truncated, info = self._env.step(action)
            total = total + earned
            steps = steps + 1
            ended = terminated or truncated
        fault = info["fault"]
        poses = np.array(rows).reshape(-1, 7 + joints)
        where = np.zeros(2) if fault else info["base_pos"][:2]
        no_motion = np.zeros((0, 6 + 2 * joints))
        return Episode(
            total,
            steps,
            self._env.gait.speed_errors / steps,
            where,
            fault,
            mean,
            m2,
            poses,
            no_motion,
        )

    def close(self) -> None:
        """Close the engine."""
        self._env.close()
