"""Policy from a flat vector of parameters, and back, with left-right symmetry.

A robot with pairs of legs is its own mirror image, and so is its gait, half a cycle later or at
once if the legs of a pair step together. A policy that gives the mirrored action for the mirrored
observation cannot limp to one side.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import RunningStats
from motorprior.locomotion.gait import action_size, observation_size
from motorprior.locomotion.policy import PolicyArrays
from motorprior.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class PolicyShape:
    """Sizes of a policy, and its symmetry.

    The parameters are W (actions, inputs), H (units, inputs) and V (units, actions), row by row.
    With a mirror, W is made symmetric, and every hidden unit gets a mirrored copy: H above H·O and
    V above V·A.
    """

    num_joints: int
    units: int = 0  # hidden units before mirroring; 0 for a linear policy
    # mirror symmetry of the robot in its gait; None for a policy without
    mirror: "Mirror | None" = None

    @classmethod
    def of(cls, robot: Robot, hidden_units: int, symmetric: bool) -> "PolicyShape":
        """Shape of a robot's policy; ConfigError for an impossible symmetry."""
        if not symmetric:
            return cls(robot.num_joints, hidden_units)
        if hidden_units % 2:
            problem = f"hidden_units {hidden_units} is odd"
            problem += ", and a symmetric policy has them in mirrored pairs"
            remedy = f"give {hidden_units + 1}, or train without symmetry"
            raise ConfigError(problem, remedy=remedy, argument="hidden_units")
        return cls(robot.num_joints, hidden_units // 2, mirror_of(robot))

    @property
    def observations(self) -> int:
        """Length of an observation."""
        return observation_size(self.num_joints)

    @property
    def size(self) -> int:
        """Number of parameters."""
        inputs = self.observations + 1
        actions = action_size(self.num_joints)
        return actions * inputs + self.units * (inputs + actions)

    def split(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Views of W, H and V in (size,) parameters."""
        inputs = self.observations + 1
        actions = action_size(self.num_joints)
        first = actions * inputs
        second = (actions + self.units) * inputs
        return (
            parameters[:first].reshape(actions, inputs),
            parameters[first:second].reshape(self.units, inputs),
            parameters[second:].reshape(self.units, actions),
        )

    def policy(self, parameters: np.ndarray, observations: RunningStats) -> PolicyArrays:
        """The policy of (size,) parameters, normalised by the statistics of its observations."""
        weights, hidden, readout = self.split(parameters)
        if self.mirror is not None:
            inputs, action = self.mirror
            weights = 0.5 * (weights + action @ weights @ inputs)  # the nearest symmetric ones
            hidden = np.concatenate([hidden, hidden @ inputs])
            readout = np.concatenate([readout, readout @ action])
        stats = self.symmetric_stats(observations)
        return PolicyArrays(np.asfortranarray(weights), hidden, readout, stats.mean, stats.std())

    def untrained(self) -> PolicyArrays:
        """The policy of zero actions, which is the untrained gait."""
        return self.policy(np.zeros(self.size), RunningStats.empty(self.observations))

    def symmetric_stats(self, observations: RunningStats) -> RunningStats:
        """Statistics of observations together with their mirror images, if there is a mirror."""
        if self.mirror is None:
            return observations

        swap = self.mirror.inputs[:-1, :-1]
        mirrored_mean = swap @ observations.mean
        mirrored_m2 = np.abs(swap) @ observations.m2
        mirrored = RunningStats(observations.count, mirrored_mean, mirrored_m2)
        return observations.merge(mirrored)

    def parameters(self, policy: PolicyArrays) -> np.ndarray:
        """(size,) parameters of a policy: the inverse of `policy`.

        ConfigError for a policy of another shape.
        """
        units = self.units if self.mirror is None else 2 * self.units
        if len(policy.hidden) != units:
            start_units = len(policy.hidden)
            problem = f"the policy to start from has {start_units} hidden units, wanted {units}"
            raise ConfigError(problem, remedy="train with as many", argument="hidden_units")

        weights = policy.weights.ravel()
        hidden = policy.hidden[: self.units].ravel()
        readout = policy.readout[: self.units].ravel()
        parameters = np.concatenate([weights, hidden, readout])

        # a policy that is not symmetric is no policy of these parameters
        restored = self.policy(parameters, RunningStats.empty(self.observations))
        for name in ("weights", "hidden", "readout"):
            is_same = np.allclose(
                getattr(restored, name), getattr(policy, name), rtol=1e-6, atol=1e-9
            )
            if not is_same:
                problem = f"the {name} of the policy to start from are not symmetric"
                raise ConfigError(problem, remedy="train without symmetry", argument="symmetric")
        return parameters


_TOLERANCE = 0.02  # [m] between a foot and its partner's mirror image, [-] between their phases


class Mirror(NamedTuple):
    """Mirrors O of inputs and A of actions.

    Each is the symmetric matrix of a permutation with signs, which is its own inverse.
    """

    inputs: np.ndarray  # (inputs, inputs), of an observation and the bias at its end
    action: np.ndarray  # (actions, actions)


def mirror_of(robot: Robot) -> Mirror:
    """Mirror of a robot's observations and actions.

    ConfigError if legs or gait have no mirror image.
    """
    partners = _partners(robot)
    joints = np.arange(robot.num_joints)
    sign = np.ones(robot.num_joints)
    for leg, partner in zip(robot.legs, partners, strict=True):
        joints[list(leg.joints)] = robot.legs[partner].joints
        sign[leg.joints[0]] = -1.0
    swap = sign[:, None] * np.eye(robot.num_joints)[joints]

    imu = np.diag([-1.0, 1.0, -1.0, 1.0, -1.0])
    drift_and_heading_error = [-1.0, -1.0]
    command = [1.0, -1.0]
    phase = [_phase_sign(robot, partners)] * 2
    bias = 1.0
    follower = np.diag([*drift_and_heading_error, *command, *phase, bias])
    modulation = np.diag([1.0, 1.0, 1.0, 1.0, -1.0])  # the turn changes its sign
    return Mirror(
        inputs=np.asarray(block_diag(imu, swap, follower)),
        action=np.asarray(block_diag(swap, modulation)),
    )


def _partners(robot: Robot) -> list[int]:
    """For each leg, its mirror image; a leg in the middle is its own."""
    rest = np.array([leg.rest for leg in robot.legs])
    partners = [int(np.argmin(np.abs(rest - [x, -y]).sum(axis=1))) for x, y in rest]
    for leg, partner in enumerate(partners):
        distance = np.abs(rest[partner] - rest[leg] * [1.0, -1.0]).max()
        if partners[partner] != leg or distance > _TOLERANCE:
            problem = f"leg {robot.legs[leg].name!r} has no mirror image"
            problem += f" among the legs of robot {robot.name!r}"
            raise ConfigError(problem, remedy="train without symmetry", argument="symmetric")
    return partners


def _phase_sign(robot: Robot, partners: list[int]) -> float:
    """-1 if the legs of a pair step half a cycle apart, 1 if together."""
    phases = np.array([leg.phase for leg in robot.legs])
    apart = (phases[partners] - phases) % 1.0
    for shift, sign in ((0.5, -1.0), (0.0, 1.0)):
        error = np.abs(apart - shift)
        if np.minimum(error, 1.0 - error).max() <= _TOLERANCE:
            return sign

    problem = f"the legs of robot {robot.name!r} step neither together with their mirror images"
    problem += " nor half a cycle later"
    remedy = "correct the phases in its file, or train without symmetry"
    raise ConfigError(problem, remedy=remedy, argument="symmetric")
