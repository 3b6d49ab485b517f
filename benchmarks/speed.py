"""Control steps per second of compiled episodes, and the share of the physics engine in them.

    python benchmarks/speed.py --prior runs/prior/prior.safetensors

Zero-policy trots of the prior's robot. Every path runs in turn in one process; figures are medians
of the rounds, per core. Only ratios within a run are comparable between machines.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import report
from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.fleet import load_robot_fleet, nominal_pd
from motorprior.actuator.kernels import without_refcounts
from motorprior.compiled import njit
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gait import open_loop_gait, walker_arrays
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.priors.prior_file import load_prior
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.mujoco_library import mj_step
from motorprior.simulation.physics import WorldArrays, physics_step
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator
from motorprior.simulation.world import World

LEARNED = "rollout"


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    prior: Path  # prior of the default robot
    steps: int = 500  # maximum control steps of an episode
    rounds: int = 7  # rounds of all paths


@dataclass(frozen=True)
class TimedPath:
    """A path through the simulation."""

    control_steps: int
    run: Callable[[], float]  # runs the steps; returns their time on one core [s]


@njit(cache=True, nogil=True)
def record_drive(
    world: WorldArrays, motors: ActuatorArrays, targets: np.ndarray, drive: np.ndarray
) -> None:
    """Record torque and damping that the engine gets for these targets.

    They are written to ``drive`` (2, physics steps, joints).
    """
    applied = world.applied[world.applied.shape[0] - targets.shape[1] :]
    row = 0
    for step in range(targets.shape[0]):
        for _ in range(world.substeps):
            physics_step(world, motors, targets[step])
            drive[0, row] = applied
            drive[1, row] = world.damping
            row += 1


@njit(cache=True, nogil=True)
def replay_drive(world: WorldArrays, drive: np.ndarray) -> None:
    """Run mj_step alone with recorded torque and damping."""
    world = without_refcounts(world)
    drive = without_refcounts(drive)
    applied = world.applied[world.applied.shape[0] - drive.shape[2] :]
    for row in range(drive.shape[1]):
        applied[:] = drive[0, row]
        world.damping[:] = drive[1, row]
        mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]


def timed(work: Callable[[], object]) -> float:
    """Time of a call [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def episode_path(robot: mp.Robot, actuator: Actuator, steps: int) -> TimedPath:
    """A compiled episode on these motors."""
    max_speed = robot.require_gait().forward[1]
    walk = WalkConfig(steps, commands=Commands.steady(max_speed))
    physics_dt = robot.physics_step(actuator.kind.max_step)
    simulator = WalkSimulator(Scene(robot, lambda rng: actuator, walk, physics_dt))
    trot = PolicyShape(robot.num_joints).untrained()
    control_steps = simulator.run(trot, 0).steps
    return TimedPath(control_steps, lambda: timed(lambda: simulator.run(trot, 0)))


def engine_path(robot: mp.Robot, actuator: Actuator, steps: int) -> TimedPath:
    """The engine alone, with the torques of an open-loop trot on these motors."""
    world = World(robot)
    walker = walker_arrays(robot)
    targets = open_loop_gait(walker, steps, walker.max_speed, walker.frequency, 0.0, 1.0)
    drive = np.zeros((2, steps * world.substeps, robot.num_joints))
    simulation = world.reset(actuator)
    record_drive(simulation.arrays, simulation.motors, targets, drive)

    def run() -> float:
        arrays = world.reset(actuator).arrays
        return timed(lambda: replay_drive(arrays, drive))

    return TimedPath(steps, run)


def compute(settings: Settings) -> dict[str, float]:
    """Figures of all paths."""
    robot = mp.load_robot(DEFAULT_ROBOT)
    fleet = load_robot_fleet(robot)
    prior = load_prior(settings.prior, robot)
    actuators: dict[str, Actuator] = {
        "ideal_pd": nominal_pd(fleet, robot.num_joints),
        LEARNED: prior.sample(robot.num_joints, np.random.default_rng(0)),
        "physical": fleet.center(robot.num_joints).actuator(),
    }
    paths = {
        name: episode_path(robot, actuator, settings.steps) for name, actuator in actuators.items()
    }
    paths["mj_step"] = engine_path(robot, actuators[LEARNED], paths[LEARNED].control_steps)

    # seconds per control step, one per round
    times = {name: np.zeros(settings.rounds) for name in paths}
    for number in range(settings.rounds):
        for name, path in paths.items():
            path.run()  # warm the caches
            times[name][number] = path.run() / path.control_steps

    figures = {
        f"control_steps_per_s/{name}": float(np.median(1.0 / values))
        for name, values in times.items()
    }
    figures["mj_step_share"] = float(np.median(times["mj_step"] / times[LEARNED]))
    figures["learned_over_pd"] = float(np.median(times[LEARNED] / times["ideal_pd"]))
    return figures


if __name__ == "__main__":
    report(compute(tyro.cli(Settings, description=__doc__)), None)
