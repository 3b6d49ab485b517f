"""Train a walking policy: ARS over episodes, each with newly drawn motors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motorprior.bounds import seed_of
from motorprior.locomotion.ars import Ars, ArsConfig, Candidate, perturbed
from motorprior.locomotion.executor import Executor
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.locomotion.running_stats import RunningStats

EVALUATION_EVERY, EVALUATION_DRAWS = 10, 16  # iterations, episodes
EVALUATION = 2**32 - 1  # stands for the iteration in the seeds of evaluation episodes
HIDDEN = 2**32 - 2  # stands for the iteration in the seed of the initial hidden units
START_OBSERVATIONS = 100_000  # weight of a start policy's observation statistics: about a dozen iterations


@dataclass(frozen=True)
class Iteration:
    """A point of the learning curve: means over the episodes, and the number of episodes by fault."""

    iteration: int
    mean_return: float
    best_return: float
    mean_steps: float
    mean_speed_error: float
    faults: dict[int, int]


@dataclass(frozen=True, eq=False)
class Round:
    """State of a search that all episodes of an iteration share."""

    parameters: np.ndarray
    observations: RunningStats
    config: ArsConfig
    iteration: int
    shape: PolicyShape

    @classmethod
    def of(cls, search: Ars, shape: PolicyShape) -> Round:
        """The present state."""
        return cls(search.parameters, search.observations, search.config, search.iteration, shape)

    def policy(self, candidate: Candidate) -> PolicyArrays:
        """Policy of a candidate."""
        parameters = perturbed(self.parameters, candidate, self.config, self.iteration)
        return self.shape.policy(parameters, self.observations, self.config.normalise)


@dataclass(frozen=True)
class EpisodeTask:
    """An episode to run: a candidate, and the seed of its motors."""

    candidate: Candidate
    seed: int


@dataclass(frozen=True, eq=False)
class BestPolicy:
    """The best policy so far, its mean return [m] in evaluation, and its iteration; -1 if there is none."""

    policy: PolicyArrays
    score: float
    iteration: int

    @classmethod
    def none_yet(cls, shape: PolicyShape) -> BestPolicy:
        """The zero policy with a score below every other."""
        zero = shape.policy(np.zeros(shape.size), RunningStats.empty(shape.observations))
        return cls(zero, -float(np.finfo(np.float64).max), -1)

    def state(self) -> dict[str, np.ndarray]:
        """Arrays for `restore`."""
        arrays = {f"champion_{name}": value for name, value in self.policy._asdict().items()}
        return arrays | {"champion_score": np.array(self.score), "champion_iteration": np.array(self.iteration)}

    @classmethod
    def restore(cls, state: Mapping[str, np.ndarray]) -> BestPolicy:
        """The best policy from its `state`."""
        policy = PolicyArrays(*(state[f"champion_{name}"] for name in PolicyArrays._fields))
        return cls(policy, float(state["champion_score"]), int(state["champion_iteration"]))


def run_task(simulator: Any, shared: Round, task: EpisodeTask) -> Any:
    """Run one episode on a worker's simulator; returns a `simulation.rollout.Episode`."""
    return simulator.run(shared.policy(task.candidate), task.seed)


def episode_seed(seed: int, iteration: int, direction: int) -> int:
    """Seed of an episode's motors, the same for both signs of a direction."""
    return seed_of(seed, iteration, direction, 7)


def advance(search: Ars, shape: PolicyShape, executor: Executor) -> Iteration:
    """One ARS iteration: ask, run every candidate, tell."""
    iteration, seed = search.iteration, search.config.seed
    tasks = [EpisodeTask(candidate, episode_seed(seed, iteration, candidate.direction)) for candidate in search.ask()]
    episodes = executor.map(run_task, Round.of(search, shape), tasks)
    returns = np.array([episode.total for episode in episodes]).reshape(-1, 2)
    search.tell(returns, [RunningStats(episode.count, episode.mean, episode.m2) for episode in episodes])
    steps = float(np.mean([episode.steps for episode in episodes]))
    faults = Counter(int(episode.fault) for episode in episodes if episode.fault)
    speed_error = float(np.mean([episode.speed_error for episode in episodes]))
    mean, best = float(returns.mean()), float(returns.max())
    return Iteration(iteration, mean, best, steps, speed_error, dict(sorted(faults.items())))


def updated_best(search: Ars, shape: PolicyShape, evaluator: Executor, best: BestPolicy) -> BestPolicy:
    """Evaluate the policy of the averaged parameters; returns the better of it and ``best``.

    Every evaluation runs on the same EVALUATION_DRAWS draws of motors.
    """
    shared = replace(Round.of(search, shape), parameters=search.average)
    seeds = [episode_seed(search.config.seed, EVALUATION, draw) for draw in range(EVALUATION_DRAWS)]
    episodes = evaluator.map(run_task, shared, [EpisodeTask(Candidate(0, 0), seed) for seed in seeds])
    score = float(np.mean([episode.total for episode in episodes]))
    return best if score <= best.score else BestPolicy(shared.policy(Candidate(0, 0)), score, search.iteration)


def train(
    search: Ars,
    shape: PolicyShape,
    executor: Executor,
    iterations: int,
    best: BestPolicy,
    progress: Callable[[Iteration, BestPolicy], None] | None = None,
    evaluator: Executor | None = None,
    patience: int | None = None,
) -> BestPolicy:
    """Advance ``search`` to ``iterations`` iterations; returns the best policy of all evaluations.

    The policy of the averaged parameters is evaluated every EVALUATION_EVERY iterations and at the end.

    Args:
        search: to advance.
        shape: of the policy.
        executor: runs the training episodes.
        iterations: maximum.
        best: of earlier evaluations.
        progress: called after every iteration.
        evaluator: runs the evaluation episodes; ``executor`` if not given.
        patience: stop after so many evaluations in a row without a better policy; never if not given.
    """
    while search.iteration < iterations and not has_converged(search, best, patience):
        point = advance(search, shape, executor)
        if search.iteration % EVALUATION_EVERY == 0 or search.iteration == iterations:
            best = updated_best(search, shape, executor if evaluator is None else evaluator, best)
        if progress is not None:
            progress(point, best)
    return best


def has_converged(search: Ars, best: BestPolicy, patience: int | None) -> bool:
    """Whether ``patience`` evaluations in a row have found no better policy."""
    return patience is not None and search.iteration - max(0, best.iteration) >= patience * EVALUATION_EVERY


def new_search(config: ArsConfig, shape: PolicyShape, start: Policy | None = None) -> Ars:
    """A search that starts from a policy, or from the zero policy, which is the plain gait.

    The observation statistics of ``start`` get the weight of START_OBSERVATIONS observations. Without normalisation
    they are folded into the weights.

    Raises:
        ConfigError: a start of another number of hidden units, or one that is not symmetric where the shape is.
    """
    search = Ars(config, shape.size, shape.observations)
    if start is not None:
        search.parameters = search.average = shape.parameters(start if config.normalise else _without_scaling(start))
        m2 = START_OBSERVATIONS * np.square(start.observation_std)
        search.observations = RunningStats(START_OBSERVATIONS, start.observation_mean, m2)
    elif shape.units:  # hidden weights of variance 1 / inputs; with zero readout the policy is still the plain gait
        search.parameters = search.average = np.zeros(shape.size)
        _, hidden, _ = shape.split(search.parameters)
        rng = np.random.default_rng([config.seed, HIDDEN])
        hidden[:] = rng.standard_normal(hidden.shape) / np.sqrt(hidden.shape[1])
    return search


def _without_scaling(policy: Policy) -> Policy:
    """The same policy without observation scaling: [W, b]·[(x - m)/s; 1] = [W/s, b - (W/s)·m]·[x; 1]."""
    mean, std = policy.observation_mean, policy.observation_std

    def unscaled(matrix: np.ndarray) -> np.ndarray:
        scaled = matrix[:, :-1] / std
        return np.column_stack([scaled, matrix[:, -1] - scaled @ mean])

    return replace(
        policy, weights=unscaled(policy.weights), hidden=unscaled(policy.hidden),
        observation_mean=np.zeros_like(mean), observation_std=np.ones_like(std),
    )  # fmt: skip
