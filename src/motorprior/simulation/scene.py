"""An episode: its settings and engine, as a Gymnasium environment, and as one compiled call.

`WalkEnv` and that call have the same compiled functions in the same order, so the results are the
same bit for bit.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.kernels import without_refcounts
from motorprior.actuator.registry import DrawMotors
from motorprior.bounds import require_array, require_count
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion import control_step
from motorprior.locomotion.ars import update_stats
from motorprior.locomotion.command import Commands
from motorprior.locomotion.control_step import GaitState, RobotState, SensorErrors, TaskWeights
from motorprior.locomotion.gait import action_size, walker_arrays
from motorprior.locomotion.policy import PolicyArrays, act
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import BulletSimulation, BulletWorld
from motorprior.simulation.physics import FAULTS, TOO_STIFF, hold_target, read_state
from motorprior.simulation.randomization import Domain, Randomization
from motorprior.simulation.world import MujocoSimulation, World

Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class WalkConfig:
    """Settings of a walking episode; ConfigError for a number out of range or an unknown engine."""

    episode_steps: int = 500
    """Control steps until the time limit."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    randomization: Randomization = field(default_factory=Randomization)
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors,
    pushes."""
    commands: Commands = field(default_factory=Commands)
    """Commanded speeds and yaw rates; they may exceed the robot's usual range."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses
    several cores."""

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)
        if self.engine not in ENGINES:
            problem = f"engine {self.engine!r} is unknown"
            raise ConfigError(problem, remedy=f"use one of {ENGINES}", argument="engine")

    def inputs(self, robot: Robot, seed: int) -> tuple[SensorErrors, np.ndarray]:
        """Sensor errors and (steps, 2) commands [m/s], [rad/s] of the episode of this seed."""
        sensors = self.randomization.sensors(robot, seed, self.episode_steps)
        schedule = self.commands.schedule(robot, seed, self.episode_steps)
        return sensors, schedule


@dataclass(frozen=True)
class Scene:
    """Simulation of walking episodes: a robot, the source of its motors, and the settings."""

    robot: Robot  # with legs
    # the motors of an episode, from a generator seeded by the episode's seed
    draw_motors: DrawMotors
    walk: WalkConfig = field(default_factory=WalkConfig)
    # MuJoCo's step [s]; the robot's own if not given. PyBullet's is always 1 ms
    physics_dt: float | None = None

    def world(self) -> World | BulletWorld:
        """The robot in the engine of the episodes; errors as `World` and `BulletWorld`."""
        if self.walk.engine == "mujoco":
            return World(self.robot, self.physics_dt)
        return BulletWorld(self.robot)

    def sample(self, seed: int) -> tuple[Actuator, Domain]:
        """Motors and domain of the episode of this seed."""
        motors = self.draw_motors(np.random.default_rng(seed))
        domain = self.walk.randomization.domain(self.robot, seed, self.walk.episode_steps)
        return motors, domain


@dataclass(frozen=True)
class Episode:
    """Result of an episode."""

    total: float  # sum of rewards [m]
    steps: int  # control steps until the fall or the time limit
    speed_error: float  # mean over the steps of |filtered forward speed - commanded speed| [m/s]
    displacement: np.ndarray  # (2,) forward and left [m]
    fault: int  # 0 or a key of `physics.FAULTS`
    mean: np.ndarray  # (observations,) mean of the observations, one per step
    m2: np.ndarray  # (observations,) Σ (x - mean)²
    trace: np.ndarray  # (steps, 7 + joints) qpos before every control step; empty if not requested
    # (steps, 6 + 2 joints) qvel before every control step, torque in the physics step before it
    # [N·m]; empty as trace
    motion: np.ndarray


def require_walks(episodes: Sequence[Episode], name: str) -> None:
    """Raise SimulationFault if a walk of the policy ``name`` diverged, which is no fall."""
    faults = Counter(FAULTS[episode.fault] for episode in episodes if episode.fault)
    if not faults:
        return
    counted = f"{faults.total()} of {len(episodes)} walks of {name}"
    problem = f"{counted} had a simulation fault ({', '.join(faults)})"
    raise SimulationFault(f"{problem}: such walks cannot be evaluated", remedy=TOO_STIFF)


class _EpisodeMemory(NamedTuple):
    """Inputs, scratch memory and results of one episode, for compiled code."""

    sensors: SensorErrors
    schedule: np.ndarray  # (steps, 2) commanded speed [m/s] and yaw rate [rad/s]
    gait: GaitState
    action: np.ndarray  # (actions,) scratch
    measured: np.ndarray  # (joints,) scratch: encoder readings [rad]
    feet: np.ndarray  # (legs, 3) scratch: centres of the feet [m]
    mean: np.ndarray  # (observations,) mean of the observations; result
    m2: np.ndarray  # (observations,) Σ (x - mean)² of the observations; result
    # (steps, 13 + 3 joints) qpos and qvel before every control step, torque in the physics step
    # before it; no rows if not requested; result
    trace: np.ndarray


@njit(cache=True, nogil=True)
def _run_episode(walker, world, motors, policy, weights, max_steps, memory):
    """Run an episode; returns total reward, steps and fault. Arrays of ``memory`` are written."""
    walker = without_refcounts(walker)
    world = without_refcounts(world)
    motors = without_refcounts(motors)
    policy = without_refcounts(policy)
    weights = without_refcounts(weights)
    memory = without_refcounts(memory)
    gait = memory.gait
    nq = world.qpos.shape[0]
    nv = world.qvel.shape[0]

    control_step.begin_gait(walker, gait)
    state = read_state(world, motors, 0.0, memory.measured, memory.feet)
    control_step.observe(walker, state, gait.observation)

    total = 0.0
    steps = 0
    fault = 0
    for step in range(max_steps):
        control_step.complete_observation(
            walker, gait, memory.sensors, memory.schedule, step, world.qpos[3:7]
        )
        if memory.trace.shape[0] > 0:
            memory.trace[step, :nq] = world.qpos
            memory.trace[step, nq : nq + nv] = world.qvel
            memory.trace[step, nq + nv :] = world.torque
        update_stats(gait.observation, step, memory.mean, memory.m2)

        act(policy, gait.observation, memory.action)
        control_step.command_step(walker, gait, memory.action)
        torque_squared_sum = hold_target(world, motors, gait.target)
        state = read_state(world, motors, torque_squared_sum, memory.measured, memory.feet)
        reward, ended = control_step.evaluate_step(walker, gait, state, weights)

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
        self._walker = walker_arrays(scene.robot)
        self._world = World(scene.robot, scene.physics_dt)
        self._weights = scene.walk.task.array()

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """One episode of a policy of the robot; ``seed`` draws motors, domain and commands."""
        motors, domain = self._scene.sample(seed)
        simulation = self._world.reset(motors, domain=domain)
        world = simulation.arrays
        memory = self._memory(policy, seed, trace)
        max_steps = self._scene.walk.episode_steps

        total, steps, fault = _run_episode(
            self._walker, world, simulation.motors, policy, self._weights, max_steps, memory
        )

        nq = len(world.qpos)
        return Episode(
            total=total,
            steps=steps,
            speed_error=memory.gait.speed_errors / steps,
            displacement=np.zeros(2) if fault else world.qpos[:2].copy(),
            fault=fault,
            mean=memory.mean,
            m2=memory.m2,
            trace=np.ascontiguousarray(memory.trace[:steps, :nq]),
            motion=memory.trace[:steps, nq:],
        )

    def _memory(self, policy: PolicyArrays, seed: int, trace: bool) -> _EpisodeMemory:
        robot = self._scene.robot
        sensors, schedule = self._scene.walk.inputs(robot, seed)
        gait = control_step.new_gait(self._walker)
        trace_rows = self._scene.walk.episode_steps if trace else 0
        trace_columns = 7 + 6 + 3 * robot.num_joints
        return _EpisodeMemory(
            sensors=sensors,
            schedule=schedule,
            gait=gait,
            action=np.zeros_like(gait.scaled_action),
            measured=np.zeros_like(gait.target),
            feet=np.zeros((len(gait.feet), 3)),
            mean=np.zeros_like(policy.mean),
            m2=np.zeros_like(policy.mean),
            trace=np.zeros((trace_rows, trace_columns)),
        )

    def close(self) -> None:
        """Nothing to close."""


class WalkEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Follow commands of speed and yaw rate; see `locomotion.control_step` for the order of a step.

    Every episode has new motors and a new domain. A real robot is not behind this interface: its
    control step is a deadline that depends on the age of the telemetry, and a fault in it ends in a
    crouch or without current. `hardware.motions` plays the policy instead.

    Attributes:
        world: the simulated robot, in either engine.
        gait: state of the gait.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, scene: Scene):
        self.observation_space = _observation_space(scene.robot)
        self.action_space = Box(-1.0, 1.0, (action_size(scene.robot.num_joints),), np.float64)
        self.world = scene.world()
        self._scene = scene
        self._walker = walker_arrays(scene.robot)
        self._weights = scene.walk.task.array()
        self.gait = control_step.new_gait(self._walker)
        self._episode: _RunningEpisode | None = None

    @property
    def simulation(self) -> MujocoSimulation | BulletSimulation:
        """The robot in the present episode; ConfigError before the first reset."""
        return self._require_episode().simulation

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; without a seed the env's own generator draws one.

        ``options`` is unused. Returns the observation and the info that `step` describes; raises
        SimulationFault if the engine has a fault.
        """
        super().reset(seed=seed)
        episode_seed = int(self.np_random.integers(2**31)) if seed is None else int(seed)

        self._episode = None
        motors, domain = self._scene.sample(episode_seed)
        simulation = self.world.reset(motors, domain=domain)
        state = simulation.state()
        if state.fault != 0:
            raise SimulationFault(f"{FAULTS[state.fault]} at reset", remedy=TOO_STIFF)

        sensors, schedule = self._scene.walk.inputs(self._scene.robot, episode_seed)
        self._episode = _RunningEpisode(simulation, sensors, schedule)
        control_step.begin_gait(self._walker, self.gait)
        control_step.observe(self._walker, state, self.gait.observation)
        return self._observation(self._episode, state), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by one control step with an (actions,) action, clipped to [-1, 1].

        Returns observation, reward [m], terminated (fell or fault), truncated (time is up), and an
        info with fault, phase, command in force (2,) [m/s, rad/s], position_target and
        measured_joint_pos (joints,) [rad], base_pos (3,) [m] and base_quat (4,).
        """
        episode = self._require_episode()
        if episode.has_ended:
            raise _outside_episode()
        action = require_array("action", action, self.action_space.shape or ())

        control_step.command_step(self._walker, self.gait, action)
        state = episode.simulation.step(self.gait.target)
        reward, terminated = control_step.evaluate_step(
            self._walker, self.gait, state, self._weights
        )

        episode.steps += 1
        if state.fault == 0:
            observation = self._observation(episode, state)
        else:
            observation = self.gait.observation.copy()
        truncated = not terminated and episode.steps >= self._scene.walk.episode_steps
        episode.has_ended = bool(terminated or truncated)
        return observation, float(reward), bool(terminated), truncated, self._info(state)

    def close(self) -> None:
        """Close the engine."""
        self.world.close()

    def _require_episode(self) -> "_RunningEpisode":
        if self._episode is None:
            raise _outside_episode()
        return self._episode

    def _observation(self, episode: "_RunningEpisode", state: RobotState) -> np.ndarray:
        """Copy of the observation, completed by sensor errors and the command."""
        control_step.complete_observation(
            self._walker,
            self.gait,
            episode.sensors,
            episode.schedule,
            episode.steps,
            state.base_quat,
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


@dataclass
class _RunningEpisode:
    """The present episode of a `WalkEnv`."""

    simulation: MujocoSimulation | BulletSimulation
    sensors: SensorErrors
    schedule: np.ndarray  # (steps, 2) commanded speed [m/s] and yaw rate [rad/s]
    steps: int = 0  # control steps so far
    has_ended: bool = False


def _outside_episode() -> ConfigError:
    return ConfigError("step() outside an episode", remedy="call reset() first")


def _observation_space(robot: Robot) -> Box:
    """Bounds of the observation, in the order of `locomotion.control_step`."""
    tilt = [np.pi] * 2  # [rad]
    rates = [1e3] * 3  # [rad/s]
    joints = [4.0 * np.pi] * robot.num_joints  # [rad]
    drift_and_heading_error = [10.0, 1.0]  # [m], [rad]
    command = [10.0, 10.0]  # [m/s], [rad/s]
    phase = [1.0, 1.0]
    bounds = np.array([*tilt, *rates, *joints, *drift_and_heading_error, *command, *phase])
    return Box(-bounds, bounds, dtype=np.float64)


def simulator_of(scene: Scene) -> "WalkSimulator | EnvSimulator":
    """Simulator of whole episodes of a scene, compiled with MuJoCo."""
    return WalkSimulator(scene) if scene.walk.engine == "mujoco" else EnvSimulator(scene)


class EnvSimulator:
    """Runs whole episodes in a `WalkEnv`; one per thread.

    On MuJoCo the bytes equal those of `WalkSimulator`.
    """

    def __init__(self, scene: Scene):
        self._env = WalkEnv(scene)

    def run(self, policy: PolicyArrays, seed: int, trace: bool = False) -> Episode:
        """See `WalkSimulator.run`; the trace has measured joint angles, and there is no motion."""
        observation, info = self._env.reset(seed=seed)
        joints = len(info["measured_joint_pos"])
        mean = np.zeros_like(policy.mean)
        m2 = np.zeros_like(policy.mean)
        action = np.zeros(action_size(joints))

        total = 0.0
        steps = 0
        ended = False
        trace_rows = []
        while not ended:
            if trace:
                qpos = [info["base_pos"], info["base_quat"], info["measured_joint_pos"]]
                trace_rows.append(np.concatenate(qpos))
            update_stats(observation, steps, mean, m2)
            act(policy, observation, action)
            observation, reward, terminated, truncated, info = self._env.step(action)
            total = total + reward
            steps = steps + 1
            ended = terminated or truncated

        fault = info["fault"]
        return Episode(
            total=total,
            steps=steps,
            speed_error=self._env.gait.speed_errors / steps,
            displacement=np.zeros(2) if fault else info["base_pos"][:2],
            fault=fault,
            mean=mean,
            m2=m2,
            trace=np.array(trace_rows).reshape(-1, 7 + joints),
            motion=np.zeros((0, 6 + 2 * joints)),
        )

    def close(self) -> None:
        """Close the engine."""
        self._env.close()
