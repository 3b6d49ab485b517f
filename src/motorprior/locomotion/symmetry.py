"""Left-right symmetry of observations, actions and policies.

A robot with pairs of legs is its own mirror image, and so is its gait, half a cycle later or at once if the legs of a
pair step together. A policy that gives the mirrored action for the mirrored observation cannot limp to one side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import action_size, observation_size
from motorprior.locomotion.gaits import phases_of
from motorprior.robots.robot import Robot

_TOLERANCE = 0.02  # [m] between a foot and its partner's mirror image, [-] between their phases


@dataclass(frozen=True, eq=False)
class SignedPermutation:
    """A mirrored vector: mirrored[i] = sign[i] · vector[index[i]], an involution."""

    index: np.ndarray
    sign: np.ndarray

    def columns(self, matrix: np.ndarray) -> np.ndarray:
        """M' with M'·x = M·mirrored(x)."""
        out = np.empty_like(matrix)
        out[:, self.index] = matrix * self.sign
        return out

    def mirrored(self, vectors: np.ndarray) -> np.ndarray:
        """Mirrored (..., n) vectors."""
        return self.sign * vectors[..., self.index]


@dataclass(frozen=True, eq=False)
class Mirror:
    """Attributes: observation and action, the permutation with signs that mirrors each."""

    observation: SignedPermutation
    action: SignedPermutation

    @property
    def inputs(self) -> SignedPermutation:
        """Of a policy: the observation, and the bias at its end."""
        last = len(self.observation.index)
        return SignedPermutation(np.append(self.observation.index, last), np.append(self.observation.sign, 1.0))

    def symmetric(self, weights: np.ndarray) -> np.ndarray:
        """(W + A W O) / 2 with the mirrors A of actions and O of inputs: the nearest symmetric weights."""
        mirrored = self.inputs.columns(weights)
        return 0.5 * (weights + self.action.sign[:, None] * mirrored[self.action.index])


def mirror_of(robot: Robot, gait: str = "trot") -> Mirror:
    """Mirror of a robot's observations and actions in a gait.

    Raises:
        ConfigError: legs that do not form pairs, or a gait that is not its own mirror image.
    """
    partners = _partners(robot)
    joints, sign = np.arange(robot.num_joints), np.ones(robot.num_joints)
    for leg, partner in zip(robot.legs, partners, strict=True):
        joints[list(leg.joints)] = robot.legs[partner].joints
        sign[leg.joints[0]] = -1.0
    phase = _phase_sign(robot, gait, partners)
    tilt, modulation = [-1.0, 1.0, -1.0, 1.0, -1.0], [1.0, 1.0, 1.0, 1.0, -1.0]
    followed = [-1.0, -1.0, 1.0, -1.0, phase, phase]
    observed = np.arange(observation_size(robot.num_joints))
    observed[len(tilt) : len(tilt) + len(joints)] = len(tilt) + joints
    actions = np.arange(action_size(robot.num_joints))
    actions[: len(joints)] = joints
    return Mirror(
        SignedPermutation(observed, np.concatenate([tilt, sign, followed])),
        SignedPermutation(actions, np.concatenate([sign, modulation])),
    )


def _partners(robot: Robot) -> list[int]:
    """For each leg, its mirror image; a leg in the middle is its own."""
    rest = np.array([leg.rest for leg in robot.legs])
    partners = [int(np.argmin(np.abs(rest - [x, -y]).sum(axis=1))) for x, y in rest]
    for leg, partner in enumerate(partners):
        if partners[partner] != leg or np.abs(rest[partner] - rest[leg] * [1.0, -1.0]).max() > _TOLERANCE:
            raise ConfigError(
                f"leg {robot.legs[leg].name!r} has no mirror image among the legs of robot {robot.name!r}",
                remedy="train without symmetry", argument="symmetric",
            )  # fmt: skip
    return partners


def _phase_sign(robot: Robot, gait: str, partners: list[int]) -> float:
    """-1 if the legs of a pair step half a cycle apart, 1 if together."""
    phases = phases_of(robot, gait)[0]
    apart = (phases[partners] - phases) % 1.0
    for shift, sign in ((0.5, -1.0), (0.0, 1.0)):
        error = np.abs(apart - shift)
        if np.minimum(error, 1.0 - error).max() <= _TOLERANCE:
            return sign
    raise ConfigError(
        f"the legs of robot {robot.name!r} step neither together with their mirror images nor half a cycle later",
        remedy="correct the phases in its file, or train without symmetry", argument="symmetric",
    )  # fmt: skip
