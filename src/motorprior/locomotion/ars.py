"""Augmented Random Search (ARS), with an ask-and-tell interface over a flat vector of parameters.

Mania, Guy, Recht 2018, "Simple random search of static linear policies is competitive for
reinforcement learning", algorithm 2 (V2). Noise is sent to workers as seeds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.bounds import require_count, require_number
from motorprior.compiled import njit
from motorprior.exceptions import SimulationFault

AVERAGING = 0.1  # smallest weight of the newest parameters in their running average
# η: the first averages forget early parameters, which walk badly, faster than AVERAGING does
AVERAGING_DECAY = 3.0
CONSTANT_STD = 1e-6  # an observation that varies less counts as constant and is not scaled


@dataclass(frozen=True)
class ArsConfig:
    """Settings of the search."""

    num_directions: int = 16  # N, directions tried per iteration, each with both signs
    num_top_directions: int = 8  # b, best directions that the update uses, at most N
    step_size: float = 0.02  # α, step size of the update
    delta_std: float = 0.03  # ν, standard deviation of the perturbation of each parameter
    seed: int = 0  # seed of all noise, not negative

    def __post_init__(self) -> None:
        require_count("search.num_directions", self.num_directions)
        require_count("search.num_top_directions", self.num_top_directions, 1, self.num_directions)
        for name in ("step_size", "delta_std"):
            require_number(f"search.{name}", getattr(self, name), 1e-9, 1e3)
        require_count("search.seed", self.seed, 0)


class Ars:
    """State of a search: call `ask`, run an episode per candidate, `tell` the returns."""

    def __init__(self, config: ArsConfig, num_parameters: int, observation_size: int):
        self.config = config
        self.parameters = np.zeros(num_parameters)  # M
        self.average = self.parameters  # running average A of the parameters, see `tell`
        self.iteration = 0  # number of updates so far
        # statistics by which observations are normalised during an iteration
        self.observations = RunningStats.empty(observation_size)

    def direction(self, index: int) -> np.ndarray:
        """(num_parameters,) standard normal δ of a direction, the same on every worker."""
        rng = np.random.default_rng([self.config.seed, self.iteration, index])
        return rng.standard_normal(self.parameters.size)

    def ask(self) -> list[tuple[int, int]]:
        """Candidates (direction, sign) of this iteration: each direction with + and with -."""
        candidates = []
        for direction in range(self.config.num_directions):
            candidates += [(direction, 1), (direction, -1)]
        return candidates

    def candidate(self, direction: int, sign: int) -> np.ndarray:
        """Parameters to try, M + sign · ν · δ(direction)."""
        return self.parameters + sign * (self.config.delta_std * self.direction(direction))

    def tell(self, returns: np.ndarray, observations: "Sequence[RunningStats]") -> None:
        """Update the parameters, M += α / (b σ_R) · Σ (r⁺ - r⁻) δ, and their average A.

        The sum is over the b directions with the largest max(r⁺, r⁻). ``returns`` (num_directions,
        2) are r⁺ and r⁻; σ_R is the standard deviation of the 2b returns of these directions. If
        they are all equal, M stays. The statistics of the episodes' ``observations`` are merged in
        their order. Raises SimulationFault if a return is not finite.

        A += w (M - A), w = max(AVERAGING, (η + 1) / (n + η)) in update n = 1, 2, …: the
        polynomial-decay average of Shamir and Zhang 2013 (ICML, "Stochastic gradient descent for
        non-smooth optimization"), later an exponential average.
        """
        if not np.all(np.isfinite(returns)):
            raise SimulationFault(f"a return in iteration {self.iteration} is not finite")

        b = self.config.num_top_directions
        top = np.argsort(-returns.max(axis=1), kind="stable")[:b]
        sigma = returns[top].std()
        if sigma > 0.0:
            scale = self.config.step_size / (b * sigma)
            total = np.zeros_like(self.parameters)
            for index in top:
                total += (returns[index, 0] - returns[index, 1]) * self.direction(int(index))
            self.parameters = self.parameters + scale * total
        weight = max(AVERAGING, (AVERAGING_DECAY + 1.0) / (self.iteration + 1.0 + AVERAGING_DECAY))
        self.average = self.average + weight * (self.parameters - self.average)

        for episode_stats in observations:
            self.observations = self.observations.merge(episode_stats)
        self.iteration += 1

    def state(self) -> dict[str, np.ndarray]:
        """Arrays for `restore`."""
        return {
            "parameters": self.parameters,
            "average": self.average,
            "iteration": np.array(self.iteration, dtype=np.int64),
            "observation_count": np.array(self.observations.count, dtype=np.int64),
            "observation_mean": self.observations.mean,
            "observation_m2": self.observations.m2,
        }

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from a `state`, to the same bytes as an uninterrupted search."""
        self.parameters = state["parameters"]
        self.average = state["average"]
        self.iteration = int(state["iteration"])
        self.observations = RunningStats(
            count=int(state["observation_count"]),
            mean=state["observation_mean"],
            m2=state["observation_m2"],
        )


@njit(cache=True)
def update_stats(observation: np.ndarray, count: int, mean: np.ndarray, m2: np.ndarray) -> None:
    """Add one observation x to mean and m2 = Σ (x - mean)² of ``count`` earlier ones, in place.

    d = x - mean, mean += d / n, m2 += d (x - mean) with the new mean (Welford 1962).
    """
    for i in range(observation.shape[0]):
        shift = observation[i] - mean[i]
        mean[i] += shift / (count + 1)
        m2[i] += shift * (observation[i] - mean[i])


@dataclass(frozen=True, eq=False)
class RunningStats:
    """Count of observations, their (observation,) mean and (observation,) m2 = Σ (x - mean)²."""

    count: int
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def empty(cls, size: int) -> "RunningStats":
        """Statistics of no observations."""
        return cls(0, np.zeros(size), np.zeros(size))

    def merge(self, other: "RunningStats") -> "RunningStats":
        """Statistics of both together (Chan, Golub, LeVeque 1983).

        d = mean_b - mean_a, mean = mean_a + d n_b / n, M2 = M2_a + M2_b + d² n_a n_b / n.
        """
        if other.count == 0:
            return self

        count = self.count + other.count
        shift = other.mean - self.mean
        mean = self.mean + shift * (other.count / count)
        m2 = self.m2 + other.m2 + np.square(shift) * (self.count * other.count / count)
        return RunningStats(count, mean, m2)

    def std(self) -> np.ndarray:
        """Population standard deviation; 1 where an observation is constant or there is none."""
        std = np.sqrt(self.m2 / max(self.count, 1))
        return np.where(std > CONSTANT_STD, std, 1.0)
