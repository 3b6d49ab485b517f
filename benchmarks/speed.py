"""Control steps per second of compiled episodes, and the share of the physics engine in them.

    python benchmarks/speed.py --prior runs/prior/prior.safetensors

Zero-policy trots of the prior's robot. Every path runs in turn in one process; figures are medians
of REPEATS rounds, per core. Only ratios within a run are comparable between machines.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import report
from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.bench.fleet import load_robot_fleet, nominal_pd
from motorprior.compiled import njit
from motorprior.locomotion.body import body_of, open_loop_gait
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.priors.prior_file import load_prior
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator
from motorprior.simulation.world import World, WorldArrays, mj_step, physics_step

STEPS = 500
REPEATS = 7
# control steps, and a call that returns their seconds on one core
TimedPath = tuple[int, Callable[[], float]]


@njit(cache=True, nogil=True)
def recorded(
    world: WorldArrays, motors: ActuatorArrays, targets: np.ndarray, drive: np.ndarray
) -> None:
    """Record in ``drive`` (2, physics steps, joints) the torque and damping that the engine gets for these targets."""
    applied = world.applied[world.applied.shape[0] - targets.shape[1] :]
    row = 0
    for step in range(targets.shape[0]):
        for _ in range(world.substeps):
            physics_step(world, motors, targets[step])
            drive[0, row] = applied
            drive[1, row] = world.damping
            row += 1


@njit(cache=True, nogil=True)
def mj_steps(world: WorldArrays, drive: np.ndarray) -> None:
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
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def paths_of(robot: mp.Robot, actuators: dict[str, Actuator]) -> dict[str, TimedPath]:
    """Episodes with every actuator, and mj_step alone with the torques of the ``rollout`` episode."""
    zero = PolicyShape(robot.num_joints).untrained()
    learned = actuators["rollout"]
    paths = {}
    walk = WalkConfig(STEPS, commands=Commands.steady(robot.require_gait().forward[1]))
    for name, motors in actuators.items():
        physics_dt = robot.physics_step(motors.kind.max_step)
        simulator = WalkSimulator(Scene(robot, lambda rng, motors=motors: motors, walk, physics_dt))
        paths[name] = (
            simulator.run(zero, 0).steps,
            lambda own=simulator: timed(lambda: own.run(zero, 0)),
        )
    steps = paths["rollout"][0]
    world = World(robot)
    drive = np.zeros((2, steps * world.substeps, robot.num_joints))
    body = body_of(robot)
    targets = open_loop_gait(body, steps, body.max_speed, body.frequency, 0.0, 1.0)
    recorded(world.arrays, world.reset(learned), targets, drive)

    def engine_alone() -> float:
        world.reset(learned)
        return timed(lambda: mj_steps(world.arrays, drive))

    return paths | {"mj_step": (steps, engine_alone)}


def measure(prior: Path) -> None:
    """Measure and print."""
    robot = mp.load_robot(DEFAULT_ROBOT)
    fleet = load_robot_fleet(robot)
    learned = load_prior(prior, robot)
    actuators: dict[str, Actuator] = {
        "ideal_pd": nominal_pd(fleet, robot.num_joints),
        "rollout": learned.sample(robot.num_joints, np.random.default_rng(0)),
        "physical": fleet.center(robot.num_joints).actuator(),
    }
    seconds: dict[str, list[float]] = {}
    paths = paths_of(robot, actuators)
    for _ in range(REPEATS):
        for name, (steps, run) in paths.items():
            run()  # warm the caches
            seconds.setdefault(name, []).append(run() / steps)
    each = {name: np.array(values) for name, values in seconds.items()}
    figures = {
        f"control_steps_per_s/{name}": float(np.median(1.0 / values))
        for name, values in each.items()
    }
    figures["mj_step_share"] = float(np.median(each["mj_step"] / each["rollout"]))
    figures["learned_over_pd"] = float(np.median(each["rollout"] / each["ideal_pd"]))
    report(figures, None)


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
