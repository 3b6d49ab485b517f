"""Train a walking policy: ARS over episodes, each with newly sampled motors."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from motorprior.bounds import seed_of
from motorprior.locomotion.ars import Ars, ArsConfig, RunningStats
from motorprior.locomotion.executor import Executor
from motorprior.locomotion.policy import PolicyArrays
from motorprior.locomotion.policy_shape import PolicyShape

EVALUATION_EVERY = 20  # iterations between evaluations
EVALUATION_EPISODES = 16
# numbers in place of an iteration in seeds: of evaluation episodes, and of initial hidden weights
EVALUATION = 2**32 - 1
INITIAL_HIDDEN_WEIGHTS = 2**32 - 2
# Number of observations for which the statistics of a start policy count: about those of a dozen
# iterations.
START_OBSERVATIONS = 100_000


CurvePoint: TypeAlias = dict[str, Any]
"""Point of the learning curve.

The keys are iteration, mean_return and best_return [m], mean_steps, mean_speed_error [m/s], and
faults (the number of episodes by fault).
"""


def run_task(simulator: Any, search: "PolicySearch", task: tuple[int, int, int]) -> Any:
    """Run one episode (direction, sign, seed), see `PolicySearch.policy`.

    Returns a `simulation.scene.Episode`.
    """
    direction, sign, seed = task
    return simulator.run(search.policy(direction, sign), seed)


def episode_seed(seed: int, iteration: int, direction: int) -> int:
    """Seed of an episode's motors, the same for both signs of a direction."""
    return seed_of(seed, iteration, direction, 7)


class PolicySearch:
    """A search for a policy from ``start`` or from the untrained gait; picklable, for workers.

    The best policy has the largest mean return [m] of all evaluations; before the first evaluation
    it is the untrained gait.
    """

    def __init__(self, config: ArsConfig, shape: PolicyShape, start: PolicyArrays | None = None):
        self.ars = Ars(config, shape.size, shape.observations)
        self.shape = shape
        self.mean_returns = np.empty(0)  # mean training return of every iteration so far

        # the best policy of all evaluations; these are the values before the first evaluation
        self.best = shape.untrained()
        self.best_return = -float(np.finfo(np.float64).max)
        self.best_iteration = -1

        if start is not None:
            self.ars.parameters = shape.parameters(start)
            self.ars.average = self.ars.parameters
            squares = START_OBSERVATIONS * np.square(start.std)  # Σ (x - mean)²
            self.ars.observations = RunningStats(START_OBSERVATIONS, start.mean, squares)
        elif shape.units:
            # Hidden weights have the variance 1 / inputs. The readout is 0, so the policy is still
            # the untrained gait.
            _, hidden, _ = shape.split(self.ars.parameters)
            rng = np.random.default_rng([config.seed, INITIAL_HIDDEN_WEIGHTS])
            initial_weights = rng.standard_normal(hidden.shape) / np.sqrt(hidden.shape[1])
            hidden[:] = initial_weights  # ``hidden`` is a view of the parameters

    def policy(self, direction: int, sign: int) -> PolicyArrays:
        """Policy of a candidate, or of the averaged parameters if ``sign`` is 0."""
        parameters = self.ars.candidate(direction, sign) if sign else self.ars.average
        return self.shape.policy(parameters, self.ars.observations)

    def advance(self, executor: Executor) -> CurvePoint:
        """One ARS iteration: run an episode of every candidate, and update the parameters.

        Returns the point of the learning curve.
        """
        iteration = self.ars.iteration
        seed = self.ars.config.seed
        tasks = [
            (direction, sign, episode_seed(seed, iteration, direction))
            for direction, sign in self.ars.ask()
        ]
        episodes = executor.map(run_task, self, tasks)

        returns = np.array([episode.total for episode in episodes]).reshape(-1, 2)
        observations = [
            RunningStats(episode.steps, episode.mean, episode.m2) for episode in episodes
        ]
        self.ars.tell(returns, observations)
        self.mean_returns = np.append(self.mean_returns, returns.mean())
        faults = Counter(int(episode.fault) for episode in episodes if episode.fault)
        return {
            "iteration": iteration,
            "mean_return": float(returns.mean()),
            "best_return": float(returns.max()),
            "mean_steps": float(np.mean([episode.steps for episode in episodes])),
            "mean_speed_error": float(np.mean([episode.speed_error for episode in episodes])),
            "faults": dict(sorted(faults.items())),
        }

    def evaluate(self, executor: Executor) -> None:
        """Evaluate the policy of the averaged parameters, always on the same samples of motors."""
        seed = self.ars.config.seed
        tasks = [
            (0, 0, episode_seed(seed, EVALUATION, number)) for number in range(EVALUATION_EPISODES)
        ]
        episodes = executor.map(run_task, self, tasks)

        mean_return = float(np.mean([episode.total for episode in episodes]))
        if mean_return > self.best_return:
            self.best = self.policy(0, 0)
            self.best_return = mean_return
            self.best_iteration = self.ars.iteration

    def train(
        self,
        executor: Executor,
        iterations: int,
        evaluator: Executor | None = None,
        patience: int | None = None,
        progress: Callable[[CurvePoint], None] = lambda _: None,
    ) -> None:
        """Advance to ``iterations`` iterations.

        The policy is evaluated before the first iteration, every EVALUATION_EVERY iterations, and
        at the end. ``evaluator`` runs the episodes of the evaluations; ``executor`` runs them if it
        is not given. The search stops once it has `plateaued`. ``progress`` is called after every
        iteration.
        """
        evaluator = executor if evaluator is None else evaluator
        if self.best_iteration < 0:  # so the initial policy is kept if no later one is better
            self.evaluate(evaluator)
        while self.ars.iteration < iterations and not self.plateaued(patience):
            point = self.advance(executor)
            if self.ars.iteration % EVALUATION_EVERY == 0 or self.ars.iteration == iterations:
                self.evaluate(evaluator)
            progress(point)

    def plateaued(self, patience: int | None) -> bool:
        """Whether the training return has not increased for a while.

        The training return is averaged over rounds of EVALUATION_EVERY iterations. The search has
        plateaued if ``patience`` or more rounds have ended since the best round. The return in
        evaluation does not count: on other motors than in training, a policy that does not yet walk
        in its training simulation may have the largest return.
        """
        num_rounds = len(self.mean_returns) // EVALUATION_EVERY
        if patience is None or num_rounds <= patience:
            return False

        returns = self.mean_returns[: num_rounds * EVALUATION_EVERY]
        mean_of_round = returns.reshape(num_rounds, -1).mean(axis=1)
        best_round = int(mean_of_round.argmax())
        rounds_since_best = num_rounds - 1 - best_round
        return rounds_since_best >= patience

    def state(self) -> dict[str, np.ndarray]:
        """Arrays for `restore`."""
        state = self.ars.state()
        for name, value in self.best._asdict().items():
            state[f"best_{name}"] = value
        state["best_return"] = np.array(self.best_return)
        state["best_iteration"] = np.array(self.best_iteration)
        return state

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a `state`, to the same bytes as an uninterrupted search."""
        self.ars.restore(state)
        self.best = PolicyArrays(*(state[f"best_{name}"] for name in PolicyArrays._fields))
        self.best_return = float(state["best_return"])
        self.best_iteration = int(state["best_iteration"])
