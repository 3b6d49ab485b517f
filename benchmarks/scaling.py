"""Bytes and seconds of one ARS iteration, what they predict for many cores, and a check on the cores there are.

python benchmarks/scaling.py [--json FILE]        (Ray's part is left out where it is not installed)

Model of an iteration of E episodes on W workers, C chunks: the driver's own work on directions, then either its work on
C chunks or the busiest worker's episodes, whichever takes longer.
"""

import argparse
import json
import pickle
import time
from collections.abc import Callable, Sequence

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig, Candidate
from motorprior.search.executor import Executor, make_executor
from motorprior.search.executor_ray import chunk_size
from motorprior.search.policy_search import Round, Task, advance, episode_seed, new_search, run_task
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world_config import WorldConfig

SHAPE = PolicyShape.of(PUPPER_V2, "trot", hidden_units=0, symmetric=True)
EPISODE_STEPS, REPEATS = 250, 9


def draw(rng: np.random.Generator) -> IdealPd:
    """Twelve motors with rotors and delays."""
    kp = rng.uniform(8.0, 10.0, 12)
    return IdealPd(kp, 0.095 * kp, np.full(12, 1.26), rng.uniform(0.002, 0.004, 12), rng.uniform(0.0, 0.01, 12))


def make_walker() -> WalkSimulator:
    """What a worker needs."""
    return WalkSimulator(draw, WorldConfig.of(PUPPER_V2), WalkConfig(EPISODE_STEPS))


def nothing(simulator: object, shared: object, task: int) -> int:
    """A task that costs nothing but its transport."""
    return task


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Of one call, after one that does not count."""
    work()
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def iteration_seconds(executor: Executor, directions: int) -> float:
    """Of one ARS iteration."""
    search = new_search(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    return median_seconds(lambda: advance(search, SHAPE, executor), 5)


class Recorded:
    """An executor whose episodes have ended long ago: their results only arrive, in chunks, pickled."""

    def __init__(self, walker: WalkSimulator, episodes: int, workers: int):
        shared, size = Round.of(new_search(ArsConfig(), SHAPE), SHAPE), chunk_size(episodes, workers)
        tasks = [Task(Candidate(direction, 1), direction) for direction in range(size)]
        chunk = pickle.dumps([run_task(walker, shared, task) for task in tasks])
        self._chunks = [chunk] * -(-episodes // size)

    def map(self, function: Callable, shared: object, tasks: Sequence) -> list:
        """As many results as tasks."""
        return [result for chunk in self._chunks for result in pickle.loads(chunk)][: len(tasks)]

    def close(self) -> None:
        """Nothing to close."""


def update_seconds(walker: WalkSimulator, directions: int, workers: int) -> float:
    """Of an iteration without its episodes: seeds, tasks, results, statistics, update; what no worker can take over."""
    search = new_search(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    recorded = Recorded(walker, 2 * directions, workers)
    return median_seconds(lambda: advance(search, SHAPE, recorded))


def predicted(figures: dict[str, float], workers: int, directions: int) -> float:
    """Seconds of an iteration on Ray."""
    episodes = 2 * directions
    size = chunk_size(episodes, workers)
    chunks = -(-episodes // size)
    busiest = -(-chunks // workers) * (size * figures["episode_s"]) + figures["ray_round_trip_s"]
    driver = chunks * figures["ray_chunk_s"]
    return figures["update_s_per_direction"] * directions + max(driver, busiest)


def travelling(walker: WalkSimulator, directions: int, workers: int) -> dict[str, float]:
    """Bytes per task and per result, pickled in chunks as they travel: what tasks have in common is written once."""
    search = new_search(ArsConfig(num_directions=directions, num_top_directions=directions // 2), SHAPE)
    shared, candidates = Round.of(search, SHAPE), search.ask()
    size = chunk_size(len(candidates), workers)
    tasks = [Task(candidate, episode_seed(0, 0, candidate.direction)) for candidate in candidates[:size]]
    episodes = [run_task(walker, shared, task) for task in tasks]
    sizes = {"task": len(pickle.dumps(tasks)) / size, "result": len(pickle.dumps(episodes)) / size}
    return {f"bytes_per_{name}/chunks_of_{size}": value for name, value in sizes.items()}


def main() -> None:
    """Measure, predict, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json")
    path = parser.parse_args().json
    walker, search = make_walker(), new_search(ArsConfig(), SHAPE)
    shared = Round.of(search, SHAPE)
    figures: dict[str, float] = {
        "bytes_shared": len(pickle.dumps(shared)),
        **travelling(walker, 16, 2),
        **travelling(walker, 8192, 64),
        "episode_s": median_seconds(lambda: walker.run(shared.policy(Candidate(0, 0)), 0)),
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
    for name, value in figures.items():
        print(f"{name}: {value:.4g}")
    if path:
        with open(path, "w", encoding="utf-8") as file:
            json.dump(figures, file, indent=1)


def measure_ray(figures: dict[str, float]) -> None:
    """Overheads of Ray, and iterations on it beside their prediction."""
    import ray.cloudpickle

    ray.cloudpickle.register_pickle_by_value(__import__(__name__))
    for workers in (1, 2):
        executor = make_executor(make_walker, workers, "ray")
        executor.map(nothing, None, range(16))
        if workers == 2:
            figures["ray_round_trip_s"] = median_seconds(lambda ex=executor: ex.map(nothing, None, [0]))
            many = median_seconds(lambda ex=executor: [ex.map(nothing, None, range(8)) for _ in range(8)])
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
