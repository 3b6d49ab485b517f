"""Policies that nobody trained."""

from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.locomotion.ars import RunningStats
from motorprior.locomotion.gait import action_size, observation_size
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.robots.shipped import SHIPPED

ROBOT = SHIPPED[0]
OBSERVATIONS = observation_size(ROBOT.num_joints)
ACTIONS = action_size(ROBOT.num_joints)


def random_policy(
    scale: float, seed: int, mean: float = 0.0, std: float = 1.0, units: int = 0
) -> PolicyArrays:
    """Normal weights of this standard deviation; those of hidden units have 1."""
    rng = np.random.default_rng(seed)
    weights = scale * rng.standard_normal((ACTIONS, OBSERVATIONS + 1))
    hidden = rng.standard_normal((units, OBSERVATIONS + 1))
    readout = scale * rng.standard_normal((units, ACTIONS))
    return PolicyArrays(
        weights, hidden, readout, np.full(OBSERVATIONS, mean), np.full(OBSERVATIONS, std)
    )


def stats_of(observations: np.ndarray) -> RunningStats:
    """Statistics of (N, observation) values."""
    mean = observations.mean(axis=0) if len(observations) else np.zeros(observations.shape[1])
    return RunningStats(len(observations), mean, np.square(observations - mean).sum(axis=0))


def as_file_content(arrays: PolicyArrays, **changes: Any) -> Policy:
    """The policy, for motors with the gains that the wire sends."""
    kp, kd = (np.array([getattr(joint, name) for joint in ROBOT.joints]) for name in ("kp", "kd"))
    return replace(Policy.of(ROBOT, arrays, kp, kd), **changes)
