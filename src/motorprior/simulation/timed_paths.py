"""Speed of each way of simulating an episode, and the share of the physics engine in it.

All ways are timed interleaved in one process, and compared by medians; only the ratios are meaningful.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.borrowed import borrowed
from motorprior.actuator.latent import LatentActuator
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.body import action_size
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gait_controller import GaitController
from motorprior.locomotion.policy import zero_policy
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.bullet_backend import PybulletBackend
from motorprior.simulation.bullet_world import PHYSICS_DT
from motorprior.simulation.mj_call import do_nothing_address, mj_step
from motorprior.simulation.python_loop import PythonLoopBackend, numpy_torque, torchscript_torque
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.simulation.world_step import WorldArrays, physics_step

STEPS = 500
"""Control steps of a compiled episode."""
SLOW_STEPS = 100
"""Control steps of an episode with the interpreter in the loop."""
THREADS, REPEATS, LEAST_REPEATS = 2, 7, 5
EPISODES_PER_THREAD = 6


@dataclass(frozen=True)
class TimedPath:
    """One way to simulate: ``run`` returns the seconds that ``steps`` control steps took on one core; ``close`` it."""

    steps: int
    run: Callable[[], float]
    close: Callable[[], None] = lambda: None


@njit(cache=True, nogil=True)
def _record(world: WorldArrays, motors: ActuatorArrays, targets: np.ndarray, drive: np.ndarray) -> None:
    """Fill drive (2, physics steps, joints) with the torque and damping that the engine gets for these targets."""
    applied, row = world.applied[world.applied.shape[0] - targets.shape[1] :], 0
    for step in range(targets.shape[0]):
        for _ in range(world.substeps):
            physics_step(world, motors, targets[step])
            drive[0, row], drive[1, row] = applied, world.damping
            row += 1


@njit(cache=True, nogil=True)
def _mj_steps(world: WorldArrays, drive: np.ndarray) -> None:
    """mj_step alone, with the recorded drive."""
    world, drive = borrowed(world), borrowed(drive)
    applied = world.applied[world.applied.shape[0] - drive.shape[2] :]
    for row in range(drive.shape[1]):
        applied[:] = drive[0, row]
        world.damping[:] = drive[1, row]
        mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]


def zero_policy_targets(robot: Robot, steps: int) -> np.ndarray:
    """(steps, joints) targets [rad] of the zero policy: the plain trot."""
    controller, zero = GaitController(robot, robot.control_dt), np.zeros(action_size(robot.num_joints))
    targets = np.zeros((steps, robot.num_joints))
    for target in targets:
        controller.follow(robot.require_legs().forward[1], 0.0)
        target[:] = controller.command(zero)
    return targets


def _timed(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _zero_policy_episode(robot: Robot, simulator: Any) -> int:
    """Walk with the zero policy, reset and all; returns how many control steps it lasted."""
    return simulator.run(zero_policy(robot.num_joints), 0).steps


def _walking(robot: Robot, steps: int) -> WalkConfig:
    """Straight on, as fast as the robot is told to walk at most."""
    return WalkConfig(steps, commands=Commands.steady(robot.require_legs().forward[1]))


def _simulated(robot: Robot, simulator: Any) -> TimedPath:
    run = lambda: _timed(lambda: _zero_policy_episode(robot, simulator))  # noqa: E731
    return TimedPath(_zero_policy_episode(robot, simulator), run, simulator.close)


def compiled_paths(robot: Robot, actuators: dict[str, Actuator]) -> dict[str, TimedPath]:
    """Episodes in the compiled loop, and mj_step alone.

    Args:
        robot: a legged one.
        actuators: motors per path; ``rollout`` must be among them and gives the episode whose engine time is measured
            alone.
    """
    paths = {}
    for name, actuator in actuators.items():
        world = WorldConfig.of(robot, physics_dt=robot.physics_step(actuator.kind.longest_step))
        paths[name] = _simulated(
            robot, WalkSimulator(lambda rng, motors=actuator: motors, world, _walking(robot, STEPS))
        )
    learned = actuators["rollout"]
    alone = {
        "mj_step": _engine_alone(robot, learned, paths["rollout"].steps),
        "without_mj_step": _everything_else(robot, learned),
    }
    return {**alone, **paths, "two_threads": _two_threads(robot, learned)}


def interpreted_paths(robot: Robot, learned: LatentActuator) -> dict[str, TimedPath]:
    """The same motors in a Python loop with a numpy network, with TorchScript if installed, and in PyBullet if so."""
    walk = _walking(robot, SLOW_STEPS)
    paths = {}
    for name, torque in (("python_numpy", numpy_torque(learned)), ("python_torch", torchscript_torque(learned))):
        if torque is not None:
            backend = PythonLoopBackend(robot, learned, torque)
            paths[name] = _simulated(robot, BackendSimulator(robot, backend, walk))
    if find_spec("pybullet") is not None:
        backend = PybulletBackend(lambda rng: learned, WorldConfig.of(robot, physics_dt=PHYSICS_DT))
        paths["pybullet"] = _simulated(robot, BackendSimulator(robot, backend, walk))
    return paths


def _engine_alone(robot: Robot, actuator: Actuator, steps: int) -> TimedPath:
    """mj_step, and nothing else, on torques and damping of that very episode, ``steps`` control steps long.

    Raises:
        SimulationFault: the recorded drive did not lead to the recorded end, so the timing would mean nothing.
    """
    world = World(WorldConfig.of(robot))
    drive = np.zeros((2, steps * world.config.substeps, robot.num_joints))
    motors = world.reset(actuator)
    _record(world.arrays, motors, zero_policy_targets(robot, steps), drive)
    end = world.data.qpos.copy()

    def run() -> float:
        world.reset(actuator)
        return _timed(lambda: _mj_steps(world.arrays, drive))

    run()
    if not np.array_equal(world.data.qpos, end):
        raise SimulationFault("the replayed drive gave another motion")
    return TimedPath(steps, run)


def _everything_else(robot: Robot, actuator: Actuator) -> TimedPath:
    """A whole episode in which a function that does nothing stands in for mj_step: the robot stays as it is."""
    simulator = WalkSimulator(lambda rng: actuator, WorldConfig.of(robot), _walking(robot, STEPS))
    simulator.world.arrays = simulator.world.arrays._replace(step=do_nothing_address())
    return _simulated(robot, simulator)


def _two_threads(robot: Robot, actuator: Actuator) -> TimedPath:
    """Episodes on two threads at a time; their seconds per control step count for both cores together."""
    config, walk_config = WorldConfig.of(robot), _walking(robot, STEPS)
    simulators = [WalkSimulator(lambda rng: actuator, config, walk_config) for _ in range(THREADS)]
    steps = sum(_zero_policy_episode(robot, simulator) for simulator in simulators) * EPISODES_PER_THREAD
    pool = ThreadPoolExecutor(THREADS)

    def walk(simulator: WalkSimulator) -> None:
        for _ in range(EPISODES_PER_THREAD):
            _zero_policy_episode(robot, simulator)

    return TimedPath(steps, lambda: THREADS * _timed(lambda: list(pool.map(walk, simulators))), pool.shutdown)


def measure(paths: dict[str, TimedPath], repeats: int = REPEATS, progress: Callable[[], None] | None = None) -> Results:
    """Time every path ``repeats`` times, in turn, each time in the second of two runs.

    The first finds its world in no cache, since the other paths ran meanwhile; in a search the same worlds run on.

    Args:
        paths: what `compiled_paths` and `interpreted_paths` gave.
        repeats: odd, so that a median is a round that was measured, and at least 5.
        progress: called after every round.

    Returns:
        ``control_steps_per_s`` per core of every path, and the ratios of those that were measured.

    Raises:
        ConfigError: another number of repeats.
    """
    if repeats < LEAST_REPEATS or repeats % 2 == 0:
        raise ConfigError(f"{repeats} repeats are even or below {LEAST_REPEATS}", remedy=f"measure {REPEATS} times")
    seconds: dict[str, list[float]] = {name: [] for name in paths}
    for _ in range(repeats):
        for name, path in paths.items():
            path.run()
            seconds[name].append(path.run() / path.steps)
        if progress is not None:
            progress()
    rates = {name: 1.0 / np.array(values) for name, values in seconds.items()}
    speeds = (Result("control_steps_per_s", "1/s", float(np.median(values)), name) for name, values in rates.items())
    return Results.of([*speeds, *_ratios(rates)])


def _ratios(rates: dict[str, np.ndarray]) -> list[Result]:
    """Medians of the ratios within each round."""
    wanted = {
        ("mj_step_share", "rollout"): ("rollout", "mj_step", 1.0),
        ("above_mj_step_share", "rollout"): ("rollout", "without_mj_step", 1.0),
        ("learned_over_pd", None): ("ideal_pd", "rollout", 1.0),
        ("two_threads_over_one", None): ("two_threads", "rollout", float(THREADS)),
        ("kernel_over_python_numpy", None): ("rollout", "python_numpy", 1.0),
        ("kernel_over_python_torch", None): ("rollout", "python_torch", 1.0),
        ("kernel_over_pybullet", None): ("rollout", "pybullet", 1.0),
    }
    return [
        Result(quantity, "1", factor * float(np.median(rates[over] / rates[under])), model)
        for (quantity, model), (over, under, factor) in wanted.items()
        if over in rates and under in rates
    ]
