"""Bytes and seconds of one ARS iteration, their prediction for many cores, and a test on the available cores.

    python benchmarks/scaling.py [--json FILE]        (without Ray's part if Ray is not installed)

Model of an iteration of E episodes on W workers in C chunks: the driver's time per direction, plus the maximum of its
time for C chunks and the busiest worker's time.
"""

import argparse
import pickle
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from figures import report
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import Executor, chunk_size, make_executor
from motorprior.locomotion.policy_search import EpisodeTask, PolicySearch, episode_seed, run_task
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator

SHAPE = PolicyShape.of(PUPPER_V2, "trot", hidden_units=0, symmetric=True)
EPISODE_STEPS, REPEATS = 250, 9


def draw(rng: np.random.Generator) -> IdealPd:
    """Twelve motors with armature and delay."""
    kp = rng.uniform(8.0, 10.0, 12)
    return IdealPd(kp, 0.095 * kp, np.full(12, 1.26), rng.uniform(0.002, 0.004, 12), rng.uniform(0.0, 0.01, 12))


def make_walker() -> WalkSimulator:
    """The simulator of a worker."""
    return WalkSimulator(Scene(PUPPER_V2, draw, WalkConfig(EPISODE_STEPS)))


def empty_task(simulator: object, shared: object, task: int) -> int:
    """An empty task, to measure transport."""
    return task


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of a call, after one warm-up."""
    work()
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def iteration_seconds(executor: Executor, directions: int) -> float:
    """Time of one ARS iteration."""
    search = PolicySearch(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    return median_seconds(lambda: search.advance(executor), 5)


class Recorded:
    """An executor that only unpickles recorded results, in chunks."""

    def __init__(self, walker: WalkSimulator, episodes: int, workers: int):
        shared, size = PolicySearch(ArsConfig(), SHAPE), chunk_size(episodes, workers)
        tasks = [EpisodeTask(direction, 1, direction) for direction in range(size)]
        chunk = pickle.dumps([run_task(walker, shared, task) for task in tasks])
        self._chunks = [chunk] * -(-episodes // size)

    def map(self, function: Callable, shared: object, tasks: Sequence) -> list:
        """As many results as tasks."""
        return [result for chunk in self._chunks for result in pickle.loads(chunk)][: len(tasks)]

    def close(self) -> None:
        """Nothing to close."""


def update_seconds(walker: WalkSimulator, directions: int, workers: int) -> float:
    """Driver time of an iteration without episodes: seeds, tasks, results, statistics, update."""
    search = PolicySearch(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    recorded = Recorded(walker, 2 * directions, workers)
    return median_seconds(lambda: search.advance(recorded))


def predicted(figures: dict[str, float], workers: int, directions: int) -> float:
    """Predicted time of an iteration on Ray [s]."""
    episodes = 2 * directions
    size = chunk_size(episodes, workers)
    chunks = -(-episodes // size)
    busiest = -(-chunks // workers) * (size * figures["episode_s"]) + figures["ray_round_trip_s"]
    driver = chunks * figures["ray_chunk_s"]
    return figures["update_s_per_direction"] * directions + max(driver, busiest)


def message_sizes(walker: WalkSimulator, directions: int, workers: int) -> dict[str, float]:
    """Bytes per task and per result, pickled in chunks."""
    search = PolicySearch(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    candidates = search.ars.ask()
    size = chunk_size(len(candidates), workers)
    tasks = [EpisodeTask(*candidate, episode_seed(0, 0, candidate[0])) for candidate in candidates[:size]]
    episodes = [run_task(walker, search, task) for task in tasks]
    sizes = {"task": len(pickle.dumps(tasks)) / size, "result": len(pickle.dumps(episodes)) / size}
    return {f"bytes_per_{name}/chunks_of_{size}": value for name, value in sizes.items()}


def main() -> None:
    """Measure, predict, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    path = parser.parse_args().json
    walker, shared = make_walker(), PolicySearch(ArsConfig(), SHAPE)
    figures: dict[str, float] = {
        "bytes_shared": len(pickle.dumps(shared)),
        **message_sizes(walker, 16, 2),
        **message_sizes(walker, 8192, 64),
        "episode_s": median_seconds(lambda: walker.run(shared.policy(0, 0), 0)),
        "update_s_per_direction": update_seconds(walker, 1024, 64) / 1024,
    }
    for workers in (1, 2):
        executor = make_executor(make_walker, workers)
        figures[f"iteration_s/threads_{workers}"] = iteration_seconds(executor, 32)
        executor.close()
    try:
        measure_ray(figures)
    except ConfigError as error:
        print(error)
    report(figures, path)


def measure_ray(figures: dict[str, float]) -> None:
    """Overheads of Ray, and measured and predicted iterations."""
    import ray.cloudpickle

    ray.cloudpickle.register_pickle_by_value(__import__(__name__))
    for workers in (1, 2):
        executor = make_executor(make_walker, workers, "ray")
        executor.map(empty_task, None, range(16))
        if workers == 2:
            figures["ray_round_trip_s"] = median_seconds(lambda ex=executor: ex.map(empty_task, None, [0]))
            many = median_seconds(lambda ex=executor: [ex.map(empty_task, None, range(8)) for _ in range(8)])
            figures["ray_chunk_s"] = many / 64
        figures[f"iteration_s/ray_{workers}"] = iteration_seconds(executor, 32)
        executor.close()
    for workers in (1, 2):
        figures[f"predicted_iteration_s/ray_{workers}"] = predicted(figures, workers, 32)
    one = {directions: 2 * directions * figures["episode_s"] for directions in (16, 128, 1024, 8192)}
    print("directions: seconds on one core, then workers: seconds, efficiency")
    for directions, alone in one.items():
        seconds = {workers: predicted(figures, workers, directions) for workers in (2, 64, 1024)}
        row = [f"{workers}: {value:.3g} s, {alone / workers / value:.0%}" for workers, value in seconds.items()]
        print(f"{directions}: {alone:.3g} s;", "; ".join(row))


if __name__ == "__main__":
    main()
