"""Policy from a flat vector of parameters, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import action_size, observation_size
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.locomotion.running_stats import RunningStats
from motorprior.locomotion.symmetry import Mirror, mirror_of
from motorprior.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class PolicyShape:
    """Sizes of a policy, and its symmetry.

    The parameters are W (actions, inputs), H (units, inputs) and V (units, actions), row by row. With a mirror, W is
    made symmetric, and every hidden unit gets a mirrored copy: H above H·O and V above V·A, so that a mirrored
    observation gives the mirrored action.
    """

    num_joints: int
    units: int = 0  # hidden units before mirroring; 0 for a linear policy
    mirror: Mirror | None = None  # of the robot in its gait; None for a policy without symmetry

    @classmethod
    def of(cls, robot: Robot, gait: str, hidden_units: int, symmetric: bool) -> PolicyShape:
        """Shape of a robot's policy in a gait.

        Raises:
            ConfigError: symmetry of a robot or a gait that has none, or an odd number of hidden units with symmetry.
        """
        if not symmetric:
            return cls(robot.num_joints, hidden_units)
        if hidden_units % 2:
            raise ConfigError(
                f"hidden_units {hidden_units} is odd, and a symmetric policy has them in mirrored pairs",
                remedy=f"give {hidden_units + 1}, or train without symmetry", argument="hidden_units",
            )  # fmt: skip
        return cls(robot.num_joints, hidden_units // 2, mirror_of(robot, gait))

    @property
    def observations(self) -> int:
        """Length of an observation."""
        return observation_size(self.num_joints)

    @property
    def size(self) -> int:
        """Number of parameters."""
        inputs, actions = self.observations + 1, action_size(self.num_joints)
        return actions * inputs + self.units * (inputs + actions)

    def split(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Views of W, H and V in (size,) parameters."""
        inputs, actions = self.observations + 1, action_size(self.num_joints)
        first, second = actions * inputs, (actions + self.units) * inputs
        return (
            parameters[:first].reshape(actions, inputs),
            parameters[first:second].reshape(self.units, inputs),
            parameters[second:].reshape(self.units, actions),
        )

    def policy(self, parameters: np.ndarray, observations: RunningStats) -> PolicyArrays:
        """The policy of (size,) parameters, normalised by the statistics of its observations."""
        weights, hidden, readout = self.split(parameters)
        if self.mirror is not None:
            weights = self.mirror.symmetric(weights)
            hidden = np.concatenate([hidden, self.mirror.inputs.columns(hidden)])
            readout = np.concatenate([readout, self.mirror.action.mirrored(readout)])
        stats = self.symmetric_stats(observations)
        return PolicyArrays(np.asfortranarray(weights), hidden, readout, stats.mean, stats.std())

    def symmetric_stats(self, observations: RunningStats) -> RunningStats:
        """Statistics of observations together with their mirror images, if there is a mirror."""
        if self.mirror is None:
            return observations
        swap = self.mirror.observation
        mirrored = RunningStats(observations.count, swap.mirrored(observations.mean), observations.m2[swap.index])
        return observations.merge(mirrored)

    def parameters(self, policy: Policy) -> np.ndarray:
        """(size,) parameters of a policy; inverse of `policy`.

        Raises:
            ConfigError: it has another number of hidden units, or is not symmetric where this shape is.
        """
        units = self.units if self.mirror is None else 2 * self.units
        if len(policy.hidden) != units:
            raise ConfigError(
                f"the policy to start from has {len(policy.hidden)} hidden units, wanted {units}",
                remedy="train with as many", argument="hidden_units",
            )  # fmt: skip
        parts = policy.weights.ravel(), policy.hidden[: self.units].ravel(), policy.readout[: self.units].ravel()
        parameters = np.concatenate(parts)
        kept = self.policy(parameters, RunningStats.empty(self.observations))
        for name in ("weights", "hidden", "readout"):
            if not np.allclose(getattr(kept, name), getattr(policy, name), rtol=1e-6, atol=1e-9):
                raise ConfigError(
                    f"the {name} of the policy to start from are not symmetric",
                    remedy="train without symmetry", argument="symmetric",
                )  # fmt: skip
        return parameters
