"""Searches of other libraries behind one interface, and PPO, for benchmarks/optimisers.py. All maximise."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from motorprior.locomotion.policy import PolicyArrays
from motorprior.robots.robot import Robot
from motorprior.simulation.mujoco_backend import DrawMotors

CMA_STEP = 0.03
"""Standard deviation of CMA-ES at its start [-]."""
PGPE_SPEED, PGPE_DEVIATION = 0.06, 0.03
"""Most that PGPE's center moves in an iteration, in Euclidean norm, and its standard deviation at the start [-]."""
PPO_UNITS, PPO_ENVIRONMENTS, PPO_ROUND = 32, 8, 512
"""Hidden units of its policy; environments; steps of each between updates."""


class Search(Protocol):
    """Ask for candidates, tell their returns."""

    pairs: bool
    """Whether candidates 2k and 2k + 1 are mirror images: they walk on the same motors, others than the next two."""

    @property
    def center(self) -> np.ndarray:
        """(size,) what it thinks is best."""
        ...

    def ask(self) -> np.ndarray:
        """(population, size) candidates."""
        ...

    def tell(self, returns: np.ndarray) -> None:
        """(population,) returns of the candidates that were asked for last."""
        ...


class Cma:
    """CMA-ES with a diagonal covariance, by pycma: for a full one of hundreds of numbers, searches are too short."""

    pairs = False

    def __init__(self, size: int, population: int, seed: int, step: float = CMA_STEP):
        import cma

        options = {"popsize": population, "seed": seed + 1, "CMA_diagonal": True, "verbose": -9}  # 0: by the clock
        self._search: Any = cma.CMAEvolutionStrategy(np.zeros(size), step, options)
        self._asked: list[np.ndarray] = []

    @property
    def center(self) -> np.ndarray:
        """Mean of its distribution."""
        return np.array(self._search.mean)

    def ask(self) -> np.ndarray:
        """Samples of its distribution."""
        self._asked = self._search.ask()
        return np.array(self._asked)

    def tell(self, returns: np.ndarray) -> None:
        """Move and scale its distribution by the ranks of the returns."""
        self._search.tell(self._asked, [-float(each) for each in returns])


class Pgpe:
    """PGPE with symmetric samples and ClipUp (Toklu et al. 2020), by EvoTorch."""

    pairs = True

    def __init__(
        self, size: int, population: int, seed: int, speed: float = PGPE_SPEED, deviation: float = PGPE_DEVIATION
    ):
        import torch
        from evotorch.algorithms.functional import pgpe

        self._population, self._seed, self._iteration = population, seed, 0
        self._state: Any = pgpe(
            center_init=torch.zeros(size, dtype=torch.float64), center_learning_rate=speed / 2, optimizer="clipup",
            optimizer_config={"max_speed": speed}, stdev_init=deviation, stdev_learning_rate=0.1,
            ranking_method="centered", objective_sense="max",
        )  # fmt: skip
        self._asked: Any = None

    @property
    def center(self) -> np.ndarray:
        """Mean of its distribution."""
        return self._state.optimizer_state.center.numpy().copy()

    def ask(self) -> np.ndarray:
        """Samples of its distribution, each followed by its mirror image."""
        import torch
        from evotorch.algorithms.functional import pgpe_ask

        torch.manual_seed(2**20 * self._seed + self._iteration)  # its samples come from the generator of the process
        self._asked = pgpe_ask(self._state, popsize=self._population)
        return self._asked.numpy().copy()

    def tell(self, returns: np.ndarray) -> None:
        """Follow the gradient of the expected rank."""
        import torch
        from evotorch.algorithms.functional import pgpe_tell

        self._state = pgpe_tell(self._state, self._asked, torch.as_tensor(returns))
        self._iteration += 1


class Ppo:
    """PPO by Stable-Baselines3, with the settings of examples/train_ppo.py but for the net: one layer of tanh.

    Args:
        robot: that walks.
        motors: draws the motors of an episode.
        seed: of everything; two seeds share no episode.
        options: further ones of `make_env`.
    """

    def __init__(self, robot: Robot, motors: DrawMotors, seed: int, **options: Any):
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import VecNormalize

        from motorprior.environments import make_env

        torch.set_num_threads(1)
        first = PPO_ENVIRONMENTS * seed  # environment k is seeded with this and k
        envs = make_vec_env(lambda: make_env(robot, motors, **options), n_envs=PPO_ENVIRONMENTS, seed=first)
        self._envs, net = VecNormalize(envs), {"pi": [PPO_UNITS], "vf": [64, 64]}
        self._model = PPO(
            "MlpPolicy", self._envs, n_steps=PPO_ROUND, batch_size=512, gamma=0.98, seed=first, device="cpu",
            policy_kwargs={"log_std_init": -1.5, "net_arch": net},
        )  # fmt: skip

    def learn_until(self, steps: int) -> None:
        """Go on until so many control steps were taken since the beginning, in whole rounds."""
        left = steps - self._model.num_timesteps
        if left > 0:
            self._model.learn(left, reset_num_timesteps=False)

    def policy(self) -> PolicyArrays:
        """Its mean action, as a policy of ours."""
        return arrays_of(self._model.policy, self._envs)


def arrays_of(net: Any, envs: Any) -> PolicyArrays:
    """The mean action of PPO's net, with its observations normalised, as a policy of ours."""
    layer, head = net.mlp_extractor.policy_net[0], net.action_net
    hidden = np.column_stack([layer.weight.detach().numpy(), layer.bias.detach().numpy()]).astype(np.float64)
    weights = np.zeros((head.out_features, hidden.shape[1]))
    weights[:, -1] = head.bias.detach().numpy()
    seen = envs.obs_rms
    readout = np.ascontiguousarray(head.weight.detach().numpy().T.astype(np.float64))
    return PolicyArrays(weights, hidden, readout, seen.mean.copy(), np.sqrt(seen.var + envs.epsilon))
