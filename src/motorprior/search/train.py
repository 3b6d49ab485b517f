"""Train a walking policy: ARS over episodes whose motors are drawn anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from motorprior.locomotion.policy import ACTION_SIZE, NUM_PARAMETERS, OBSERVATION_SIZE
from motorprior.search.ars import Ars, ArsConfig, Moments
from motorprior.search.executor import Executor

SHAPE = (ACTION_SIZE, OBSERVATION_SIZE + 1)


class EpisodeLike(Protocol):
    """What training needs to know of an episode."""

    total: float
    steps: int
    count: int
    mean: np.ndarray
    m2: np.ndarray


@dataclass(frozen=True)
class Iteration:
    """One point of a learning curve: means over the iteration's episodes."""

    iteration: int
    mean_return: float
    best_return: float
    mean_steps: float


@dataclass(frozen=True)
class Task:
    """One episode to run."""

    weights: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    seed: int


def run_task(simulator: Any, task: Task) -> EpisodeLike:
    """Run one episode on a worker's simulator."""
    return simulator.run(task.weights, task.mean, task.std, task.seed)


def episode_seed(seed: int, iteration: int, direction: int) -> int:
    """Seed of an episode's motors; both signs of a direction walk on the same motors."""
    return int(np.random.SeedSequence([seed, iteration, direction, 7]).generate_state(1, np.uint32)[0])


def advance(search: Ars, executor: Executor) -> Iteration:
    """One ARS iteration: ask, run every candidate, tell."""
    std, mean = search.observations.std(), search.observations.mean
    iteration = search.iteration
    tasks = [
        Task(
            candidate.parameters.reshape(SHAPE),
            mean,
            std,
            episode_seed(search.config.seed, iteration, candidate.direction),
        )
        for candidate in search.ask()
    ]
    episodes = executor.map(run_task, tasks)
    returns = np.array([episode.total for episode in episodes]).reshape(-1, 2)
    search.tell(returns, [Moments(episode.count, episode.mean, episode.m2) for episode in episodes])
    steps = float(np.mean([episode.steps for episode in episodes]))
    return Iteration(iteration, float(returns.mean()), float(returns.max()), steps)


def train(
    search: Ars,
    executor: Executor,
    iterations: int,
    progress: Callable[[Iteration], None] | None = None,
) -> list[Iteration]:
    """Advance ``search`` until it has made ``iterations`` iterations; returns the new points of the curve."""
    curve = []
    while search.iteration < iterations:
        curve.append(advance(search, executor))
        if progress is not None:
            progress(curve[-1])
    return curve


def new_search(config: ArsConfig) -> Ars:
    """A search that starts from the zero policy, which trots in place."""
    return Ars(config, NUM_PARAMETERS, OBSERVATION_SIZE)
