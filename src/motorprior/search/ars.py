"""Augmented Random Search, with an ask-and-tell interface over a flat vector of parameters.

Mania, Guy, Recht 2018, "Simple random search of static linear policies is competitive for reinforcement
learning", algorithm 2. Noise is sent as seeds, from which any worker can draw direction k of iteration i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.artifacts import require_keys
from motorprior.bounds import require_count, require_number
from motorprior.exceptions import ArtifactError, ConfigError, SimulationFault
from motorprior.search.moments import Moments

MOST_DIRECTIONS = 10_000
LARGEST_SEARCH_SEED = 2**53 - 1
"""Every text of numbers keeps it; a demo makes the seeds of its searches of a thousand times its own."""
_LEAST_STEP, _LARGEST_STEP = 1e-9, 1e3
"""Of a weight of the policy: its inputs are normalised, its outputs in [-1, 1]."""
AVERAGING = 0.1
"""Weight of the newest parameters in their running average."""
_STATE_KEYS = ("parameters", "average", "iteration", "observation_count", "observation_mean", "observation_m2")


@dataclass(frozen=True)
class ArsConfig:
    """Settings of the search.

    Attributes:
        num_directions: N, directions tried per iteration, each with both signs.
        num_top_directions: b, best directions that the update uses.
        step_size: α.
        delta_std: ν, standard deviation of the perturbation of each parameter.
        normalise: observations, by their running mean and spread: version V2 of the paper; V1 does not. With b < N
            either is its version t.
        seed: seed of all noise, not negative.
    """

    num_directions: int = 16
    num_top_directions: int = 8
    step_size: float = 0.02
    delta_std: float = 0.03
    normalise: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse settings out of range, or that do not fit together."""
        require_count("search.num_directions", self.num_directions, 1, MOST_DIRECTIONS)
        require_count("search.num_top_directions", self.num_top_directions, 1, MOST_DIRECTIONS)
        if self.num_top_directions > self.num_directions:
            raise ConfigError(
                f"search.num_top_directions {self.num_top_directions} is more than search.num_directions "
                f"{self.num_directions}",
                remedy="give at most as many top directions as directions",
            )
        for name in ("step_size", "delta_std"):
            require_number(f"search.{name}", getattr(self, name), _LEAST_STEP, _LARGEST_STEP)
        require_count("search.seed", self.seed, 0, LARGEST_SEARCH_SEED)


@dataclass(frozen=True)
class Candidate:
    """One perturbed parameter vector to try, M + sign · ν · δ(direction); sign +1, -1, or 0 for M itself.

    Only these two numbers are sent to a worker; `perturbed` makes the vector there.
    """

    direction: int
    sign: int


def direction_noise(seed: int, iteration: int, direction: int, size: int) -> np.ndarray:
    """δ of a direction: standard normal, shape (size,); the same wherever it is drawn."""
    return np.random.default_rng([seed, iteration, direction]).standard_normal(size)


def perturbed(parameters: np.ndarray, candidate: Candidate, config: ArsConfig, iteration: int) -> np.ndarray:
    """The parameters that a candidate stands for, shape of ``parameters``."""
    if candidate.sign == 0:
        return parameters
    noise = direction_noise(config.seed, iteration, candidate.direction, parameters.size)
    return parameters + candidate.sign * (config.delta_std * noise)


class Ars:
    """State of a search: call `ask`, run an episode per candidate, `tell` the returns.

    Attributes:
        config: the settings.
        parameters: M, shape (num_parameters,), zeros at the start.
        average: of the latest M, shape (num_parameters,): A += AVERAGING (M - A) after every update. A step of a random
            search is mostly noise, which the average has less of (Polyak, Juditsky 1992).
        iteration: number of updates so far.
        observations: running statistics; normalise with these during an iteration.

    Args:
        config: the settings.
        num_parameters: length of the parameter vector.
        observation_size: length of an observation.
    """

    def __init__(self, config: ArsConfig, num_parameters: int, observation_size: int):
        self.config = config
        self.parameters = np.zeros(num_parameters)
        self.average = self.parameters
        self.iteration = 0
        self.observations = Moments.empty(observation_size)

    def direction(self, index: int) -> np.ndarray:
        """δ of direction ``index`` in this iteration: standard normal, shape (num_parameters,)."""
        return direction_noise(self.config.seed, self.iteration, index, self.parameters.size)

    def ask(self) -> list[Candidate]:
        """Candidates of this iteration: direction 0 with + and -, direction 1 with + and -, ..."""
        return [Candidate(index, sign) for index in range(self.config.num_directions) for sign in (1, -1)]

    def tell(self, returns: np.ndarray, observation_moments: Sequence[Moments]) -> None:
        """Update: M += α / (b σ_R) · Σ (r⁺ - r⁻) δ over the b directions with the largest max(r⁺, r⁻).

        σ_R is the standard deviation of those 2b returns. If all returns are equal, M stays.

        Args:
            returns: shape (num_directions, 2), r⁺ and r⁻ of each direction.
            observation_moments: moments of the episodes, merged in the given order; the same order, the same bytes.

        Raises:
            ConfigError: a wrong shape.
            SimulationFault: a return that is not finite.
        """
        returns = self._checked(returns)
        b = self.config.num_top_directions
        top = np.argsort(-returns.max(axis=1), kind="stable")[:b]
        sigma = returns[top].std()
        if sigma > 0.0:
            scale = self.config.step_size / (b * sigma)
            total = np.zeros_like(self.parameters)
            for index in top:
                total += (returns[index, 0] - returns[index, 1]) * self.direction(int(index))
            self.parameters = self.parameters + scale * total
        self.average = self.average + AVERAGING * (self.parameters - self.average)
        for moments in observation_moments:
            self.observations = self.observations.merge(moments)
        self.iteration += 1

    def _checked(self, returns: np.ndarray) -> np.ndarray:
        """Returns as float64, with their shape checked and all finite."""
        returns = np.asarray(returns, dtype=np.float64)
        if returns.shape != (self.config.num_directions, 2):
            raise ConfigError(f"returns have shape {returns.shape}, wanted ({self.config.num_directions}, 2)")
        if not np.all(np.isfinite(returns)):
            direction, side = np.argwhere(~np.isfinite(returns))[0]
            raise SimulationFault(
                f"return of direction {direction}{'+-'[side]} in iteration {self.iteration} is not finite"
            )
        return returns

    def state(self) -> dict[str, np.ndarray]:
        """State for `restore`, without the config, as arrays for `artifacts.write_tensors`."""
        return {
            "parameters": self.parameters.copy(),
            "average": self.average.copy(),
            "iteration": np.array(self.iteration, dtype=np.int64),
            "observation_count": np.array(self.observations.count, dtype=np.int64),
            "observation_mean": self.observations.mean.copy(),
            "observation_m2": self.observations.m2.copy(),
        }

    @classmethod
    def restore(cls, config: ArsConfig, state: Mapping[str, np.ndarray]) -> Ars:
        """Continue a search; with the same config, the bytes are those of an uninterrupted search.

        Raises:
            ArtifactError: unknown or missing keys, or arrays that do not fit each other.
        """
        require_keys(state, _STATE_KEYS, "search state")
        parameters = np.array(state["parameters"], dtype=np.float64)
        mean = np.array(state["observation_mean"], dtype=np.float64)
        m2 = np.array(state["observation_m2"], dtype=np.float64)
        average = np.array(state["average"], dtype=np.float64)
        if parameters.ndim != 1 or average.shape != parameters.shape or mean.ndim != 1 or m2.shape != mean.shape:
            raise ArtifactError(f"shapes {parameters.shape}, {mean.shape}, {m2.shape}", where="search state")
        search = cls(config, parameters.size, mean.size)
        search.parameters, search.average = parameters, average
        search.iteration = int(state["iteration"])
        search.observations = Moments(int(state["observation_count"]), mean, m2)
        return search
