"""Train a walking policy: ARS over episodes, each with newly drawn motors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from motorprior.bounds import seed_of
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.search.ars import Ars, ArsConfig, Candidate, perturbed
from motorprior.search.executor import Executor
from motorprior.search.moments import Moments
from motorprior.search.policy_shape import PolicyShape

CONTEST_EVERY, CONTEST_DRAWS = 10, 16
CONTEST = 2**32 - 1
"""Number in the seeds of contests where training seeds have the iteration."""
HIDDEN = 2**32 - 2
"""Number in the seed of the first hidden units where training seeds have the iteration."""
REMEMBERED = 100_000
"""Number of observations that the statistics of a start policy count as; about those of a dozen default iterations."""


class EpisodeLike(Protocol):
    """Attributes of an episode that training uses."""

    total: float
    steps: int
    speed_error: float
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
    mean_speed_error: float
    faults: dict[int, int]


@dataclass(frozen=True, eq=False)
class Round:
    """What the tasks of a round share: parameters and observations of the search, its noise, what they stand for."""

    parameters: np.ndarray
    observations: Moments
    config: ArsConfig
    iteration: int
    shape: PolicyShape

    @classmethod
    def of(cls, search: Ars, shape: PolicyShape) -> Round:
        """The round of the search's present state."""
        return cls(search.parameters, search.observations, search.config, search.iteration, shape)

    def policy(self, candidate: Candidate) -> PolicyArrays:
        """The policy that a candidate stands for."""
        parameters = perturbed(self.parameters, candidate, self.config, self.iteration)
        return self.shape.policy(parameters, self.observations, self.config.normalise)


@dataclass(frozen=True)
class Task:
    """One episode to run: which perturbation, on the motors of which seed."""

    candidate: Candidate
    seed: int


@dataclass(frozen=True, eq=False)
class Champion:
    """The best policy so far, its mean return [m], and the iteration it is of; -1 if there is none."""

    policy: PolicyArrays
    score: float
    iteration: int

    @classmethod
    def none_yet(cls, shape: PolicyShape) -> Champion:
        """A champion that loses against every policy."""
        nothing = shape.policy(np.zeros(shape.size), Moments.empty(shape.observations))
        return cls(nothing, -float(np.finfo(np.float64).max), -1)

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` reads."""
        arrays = {f"champion_{name}": value for name, value in self.policy._asdict().items()}
        return arrays | {
            "champion_score": np.array(self.score),
            "champion_iteration": np.array(self.iteration),
        }

    @classmethod
    def restore(cls, state: Mapping[str, np.ndarray]) -> Champion:
        """The champion from the arrays of `state`."""
        policy = PolicyArrays(*(state[f"champion_{name}"] for name in PolicyArrays._fields))
        return cls(policy, float(state["champion_score"]), int(state["champion_iteration"]))


def run_task(simulator: Any, shared: Round, task: Task) -> EpisodeLike:
    """Run one episode on a worker's simulator."""
    return simulator.run(shared.policy(task.candidate), task.seed)


def episode_seed(seed: int, iteration: int, direction: int) -> int:
    """Seed of an episode's motors; both signs of a direction walk on the same motors."""
    return seed_of(seed, iteration, direction, 7)


def advance(search: Ars, shape: PolicyShape, executor: Executor) -> Iteration:
    """One ARS iteration: ask, run every candidate, tell."""
    iteration, seed = search.iteration, search.config.seed
    tasks = [Task(candidate, episode_seed(seed, iteration, candidate.direction)) for candidate in search.ask()]
    episodes = executor.map(run_task, Round.of(search, shape), tasks)
    returns = np.array([episode.total for episode in episodes]).reshape(-1, 2)
    search.tell(returns, [Moments(episode.count, episode.mean, episode.m2) for episode in episodes])
    steps = float(np.mean([episode.steps for episode in episodes]))
    faults = Counter(int(episode.fault) for episode in episodes if episode.fault)
    off = float(np.mean([episode.speed_error for episode in episodes]))
    return Iteration(iteration, float(returns.mean()), float(returns.max()), steps, off, dict(sorted(faults.items())))


def contest(search: Ars, shape: PolicyShape, executor: Executor, champion: Champion) -> Champion:
    """The better of the champion and the policy of the search's averaged parameters, where the executor walks.

    Every contest is walked on the same CONTEST_DRAWS draws of motors.
    """
    shared = replace(Round.of(search, shape), parameters=search.average)
    seeds = [episode_seed(search.config.seed, CONTEST, draw) for draw in range(CONTEST_DRAWS)]
    episodes = executor.map(run_task, shared, [Task(Candidate(0, 0), seed) for seed in seeds])
    score = float(np.mean([episode.total for episode in episodes]))
    if score <= champion.score:
        return champion
    return Champion(shared.policy(Candidate(0, 0)), score, search.iteration)


def train(
    search: Ars,
    shape: PolicyShape,
    executor: Executor,
    iterations: int,
    champion: Champion,
    progress: Callable[[Iteration, Champion], None] | None = None,
    judge: Executor | None = None,
    patience: int | None = None,
) -> Champion:
    """Advance ``search`` until it has made ``iterations`` iterations; returns the best policy on the way.

    The last policy of a random search is not its best: every CONTEST_EVERY iterations, and at the end, the
    policy of the averaged parameters challenges the champion.

    Args:
        search: to advance.
        shape: of the policy.
        executor: where candidates walk.
        iterations: at most.
        champion: of the contests before.
        progress: called after every iteration.
        judge: where contests are walked; ``executor`` if not given.
        patience: end after so many contests in a row that the champion won; never if not given.
    """
    while search.iteration < iterations and not is_settled(search, champion, patience):
        point = advance(search, shape, executor)
        if search.iteration % CONTEST_EVERY == 0 or search.iteration == iterations:
            champion = contest(search, shape, executor if judge is None else judge, champion)
        if progress is not None:
            progress(point, champion)
    return champion


def is_settled(search: Ars, champion: Champion, patience: int | None) -> bool:
    """Whether the champion has won ``patience`` contests in a row."""
    return patience is not None and search.iteration - max(0, champion.iteration) >= patience * CONTEST_EVERY


def new_search(config: ArsConfig, shape: PolicyShape, start: Policy | None = None) -> Ars:
    """A search that starts from a policy, or from the zero policy, which leaves the gait as it is.

    The observations of a ``start`` count as REMEMBERED of its own mean and spread: the weights keep their meaning while
    new observations come in. In a search that does not normalise, mean and spread go into the weights.

    Raises:
        ConfigError: a start of another number of hidden units, or one that is not symmetric where the shape is.
    """
    search = Ars(config, shape.size, shape.observations)
    if start is not None:
        search.parameters = search.average = shape.parameters(
            start if config.normalise else _of_raw_observations(start)
        )
        deviation = REMEMBERED * np.square(start.observation_std)
        search.observations = Moments(REMEMBERED, start.observation_mean, deviation)
    elif shape.units:
        search.parameters = search.average = _small_hidden(config.seed, shape)
    return search


def _of_raw_observations(policy: Policy) -> Policy:
    """The same policy, up to the clip of outliers, without normalisation.

    [W, b]·[(x - m)/s; 1] = [W/s, b - (W/s)·m]·[x; 1].
    """
    mean, std = policy.observation_mean, policy.observation_std

    def raw(matrix: np.ndarray) -> np.ndarray:
        scaled = matrix[:, :-1] / std
        return np.column_stack([scaled, matrix[:, -1] - scaled @ mean])

    return replace(
        policy, weights=raw(policy.weights), hidden=raw(policy.hidden),
        observation_mean=np.zeros_like(mean), observation_std=np.ones_like(std),
    )  # fmt: skip


def _small_hidden(seed: int, shape: PolicyShape) -> np.ndarray:
    """(size,) zeros but for H, normal with variance 1 / inputs: units that differ, and as yet move nothing."""
    parameters = np.zeros(shape.size)
    _, hidden, _ = shape.split(parameters)
    rng = np.random.default_rng([seed, HIDDEN])
    hidden[:] = rng.standard_normal(hidden.shape) / np.sqrt(hidden.shape[1])
    return parameters
