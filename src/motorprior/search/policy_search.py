"""Train a walking policy: ARS over episodes, each with newly drawn motors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from motorprior.locomotion.body import action_size, observation_size
from motorprior.locomotion.policy import Policy
from motorprior.search.ars import Ars, ArsConfig, Candidate, Moments, perturbed
from motorprior.search.executor import Executor

CONTEST_EVERY, CONTEST_DRAWS = 10, 16
CONTEST = 2**32 - 1
"""Number in the seeds of contests where training seeds have the iteration."""
REMEMBERED = 100_000
"""Number of observations that the statistics of a start policy count as; about those of a dozen default iterations."""


class EpisodeLike(Protocol):
    """Attributes of an episode that training uses."""

    total: float
    steps: int
    fault: int
    count: int
    mean: np.ndarray
    m2: np.ndarray


@dataclass(frozen=True)
class Iteration:
    """One point of a learning curve: means over the iteration's episodes, and how many broke down, by fault number."""

    iteration: int
    mean_return: float
    best_return: float
    mean_steps: float
    faults: dict[int, int]


@dataclass(frozen=True, eq=False)
class Round:
    """What the tasks of a round share: the search's parameters, observation mean and standard deviation, its noise."""

    parameters: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    config: ArsConfig
    iteration: int

    @classmethod
    def of(cls, search: Ars) -> Round:
        """The round of the search's present state."""
        moments = search.observations
        return cls(search.parameters, moments.mean, moments.std(), search.config, search.iteration)


@dataclass(frozen=True)
class Task:
    """One episode to run: which perturbation, on the motors of which seed."""

    candidate: Candidate
    seed: int


@dataclass(frozen=True, eq=False)
class Champion:
    """The best policy so far: weights, observation mean and standard deviation, its mean return [m]."""

    weights: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    score: float
    iteration: int

    @classmethod
    def none_yet(cls, num_joints: int) -> Champion:
        """A champion that loses against every policy."""
        size, worst = observation_size(num_joints), -float(np.finfo(np.float64).max)
        return cls(np.zeros((action_size(num_joints), size + 1)), np.zeros(size), np.ones(size), worst, 0)

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` reads."""
        return {
            "champion_weights": self.weights,
            "champion_mean": self.mean,
            "champion_std": self.std,
            "champion_score": np.array(self.score),
            "champion_iteration": np.array(self.iteration),
        }

    @classmethod
    def restore(cls, state: Mapping[str, np.ndarray]) -> Champion:
        """The champion from the arrays of `state`."""
        weights, mean, std = (state[f"champion_{name}"] for name in ("weights", "mean", "std"))
        return cls(weights, mean, std, float(state["champion_score"]), int(state["champion_iteration"]))


def _as_weights(parameters: np.ndarray, observation_mean: np.ndarray) -> np.ndarray:
    """(actions, observations + 1) of a flat vector, row by row."""
    return parameters.reshape(-1, len(observation_mean) + 1)


def run_task(simulator: Any, shared: Round, task: Task) -> EpisodeLike:
    """Run one episode on a worker's simulator."""
    parameters = perturbed(shared.parameters, task.candidate, shared.config, shared.iteration)
    return simulator.run(_as_weights(parameters, shared.mean), shared.mean, shared.std, task.seed)


def episode_seed(seed: int, iteration: int, direction: int) -> int:
    """Seed of an episode's motors; both signs of a direction walk on the same motors."""
    return int(np.random.SeedSequence([seed, iteration, direction, 7]).generate_state(1, np.uint32)[0])


def advance(search: Ars, executor: Executor) -> Iteration:
    """One ARS iteration: ask, run every candidate, tell."""
    iteration, seed = search.iteration, search.config.seed
    tasks = [Task(candidate, episode_seed(seed, iteration, candidate.direction)) for candidate in search.ask()]
    episodes = executor.map(run_task, Round.of(search), tasks)
    returns = np.array([episode.total for episode in episodes]).reshape(-1, 2)
    search.tell(returns, [Moments(episode.count, episode.mean, episode.m2) for episode in episodes])
    steps = float(np.mean([episode.steps for episode in episodes]))
    faults = Counter(int(episode.fault) for episode in episodes if episode.fault)
    return Iteration(iteration, float(returns.mean()), float(returns.max()), steps, dict(sorted(faults.items())))


def contest(search: Ars, executor: Executor, champion: Champion) -> Champion:
    """The better of the champion and the present, unperturbed policy, in its own simulation.

    Every contest is walked on the same CONTEST_DRAWS draws of motors.
    """
    shared = Round.of(search)
    seeds = [episode_seed(search.config.seed, CONTEST, draw) for draw in range(CONTEST_DRAWS)]
    episodes = executor.map(run_task, shared, [Task(Candidate(0, 0), seed) for seed in seeds])
    score = float(np.mean([episode.total for episode in episodes]))
    if score <= champion.score:
        return champion
    return Champion(_as_weights(shared.parameters, shared.mean), shared.mean, shared.std, score, search.iteration)


def train(
    search: Ars,
    executor: Executor,
    iterations: int,
    champion: Champion,
    progress: Callable[[Iteration, Champion], None] | None = None,
) -> Champion:
    """Advance ``search`` until it has made ``iterations`` iterations; returns the best policy on the way.

    The last policy of a random search is not its best: every CONTEST_EVERY iterations, and at the end, the
    present policy challenges the champion.
    """
    while search.iteration < iterations:
        point = advance(search, executor)
        if search.iteration % CONTEST_EVERY == 0 or search.iteration == iterations:
            champion = contest(search, executor, champion)
        if progress is not None:
            progress(point, champion)
    return champion


def new_search(config: ArsConfig, num_joints: int, start: Policy | None = None) -> Ars:
    """A search that starts from a policy, or from the zero policy, which trots in place.

    The observations of a ``start`` count as REMEMBERED of its own mean and spread: the weights keep their meaning while
    new observations come in.
    """
    observations = observation_size(num_joints)
    search = Ars(config, action_size(num_joints) * (observations + 1), observations)
    if start is not None:
        search.parameters = start.weights.ravel().copy()
        deviation = REMEMBERED * np.square(start.observation_std)
        search.observations = Moments(REMEMBERED, start.observation_mean, deviation)
    return search
