"""How fast the rollout kernel is, and how much of an episode is the physics engine itself.

Everything is measured side by side in one process, interleaved, as medians; only the ratios mean anything.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import njit

from motorprior.actuator.actuator import Actuator
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.control_step import command_step
from motorprior.locomotion.policy import ACTION_SIZE, OBSERVATION_SIZE
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.mj_call import mj_step
from motorprior.simulation.replay import replay
from motorprior.simulation.rollout import Episode, WalkConfig, WalkSimulator
from motorprior.simulation.world import World, WorldArrays, WorldConfig

STEPS = 500


@njit(cache=True, nogil=True)
def _mj_steps(world: WorldArrays, torque: np.ndarray) -> None:
    """mj_step alone, with recorded torques (steps, 12)."""
    applied = world.applied[world.applied.shape[0] - torque.shape[1] :]
    for row in range(torque.shape[0]):
        applied[:] = torque[row]
        mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]


def zero_policy_targets(steps: int) -> np.ndarray:
    """(steps, 12) targets [rad] of the zero policy: the plain trot."""
    filter_state, command = np.zeros(ACTION_SIZE), np.zeros(ACTION_SIZE)
    targets, phase = np.zeros((steps, spec.NUM_JOINTS)), 0.0
    for step in range(steps):
        phase = command_step(np.zeros(ACTION_SIZE), filter_state, phase, spec.CONTROL_DT, command, targets[step])
    return targets


def _timed(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _episode(actuator: Actuator, physics_dt: float) -> tuple[Callable[[], float], int]:
    """Times a whole episode of the zero policy, reset and all [s]; and how many control steps it lasts."""
    simulator = WalkSimulator(lambda rng: actuator, WorldConfig(physics_dt=physics_dt), WalkConfig(STEPS))
    weights = np.zeros((ACTION_SIZE, OBSERVATION_SIZE + 1))
    mean, std = np.zeros(OBSERVATION_SIZE), np.ones(OBSERVATION_SIZE)

    def run() -> Episode:
        return simulator.run(weights, mean, std, 0)

    return lambda: _timed(run), run().steps


def _engine_alone(actuator: Actuator, steps: int) -> Callable[[], float]:
    """Times mj_step, and nothing else, on the torques of that very episode, ``steps`` control steps long [s].

    Raises:
        SimulationFault: the recorded torques did not lead to the recorded end, so the timing would mean nothing.
    """
    world = World(WorldConfig())
    recorded = replay(world, actuator, zero_policy_targets(steps))

    def run() -> float:
        world.reset(actuator)
        return _timed(lambda: _mj_steps(world.arrays, recorded.joint_torque))

    run()
    if not np.array_equal(world.data.qpos[-spec.NUM_JOINTS :], recorded.joint_pos[-1]):
        raise SimulationFault("replayed torques gave another motion")
    return run


def measure(actuators: dict[str, tuple[Actuator, float]], repeats: int = 7) -> dict[str, float]:
    """Time every path ``repeats`` times, in turn.

    Args:
        actuators: per path its 12 motors and the physics step [s]; ``rollout`` must be among them, with no
            implicit damping, and gives the episode whose engine time is measured alone.
        repeats: odd, at least 5.

    Returns:
        ``control_steps_per_s/PATH`` per core, ``mj_step_share/rollout`` and, where there is a PD,
        ``learned_over_pd``.
    """
    episodes = {name: _episode(actuator, dt) for name, (actuator, dt) in actuators.items()}
    steps = {name: length for name, (_, length) in episodes.items()}
    works: dict[str, Callable[[], float]] = {name: work for name, (work, _) in episodes.items()}
    steps["mj_step"] = steps["rollout"]
    works["mj_step"] = _engine_alone(actuators["rollout"][0], steps["rollout"])
    for work in works.values():
        work()
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            seconds[name].append(work())
    medians = {name: float(np.median(values)) for name, values in seconds.items()}
    figures = {f"control_steps_per_s/{name}": steps[name] / value for name, value in medians.items()}
    shares = np.array(seconds["mj_step"]) / np.array(seconds["rollout"])
    figures["mj_step_share/rollout"] = float(np.median(shares))
    if "ideal_pd" in medians:
        per_step = {name: medians[name] / steps[name] for name in ("rollout", "ideal_pd")}
        figures["learned_over_pd"] = per_step["rollout"] / per_step["ideal_pd"]
    return figures
