"""Policies without training."""

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
    """Policy with normal weights of standard deviation ``scale``; into hidden units, of 1."""
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
    """The policy with the gains of the robot's joints; ``changes`` are fields of `Policy`."""
    kp = np.array([joint.kp for joint in ROBOT.joints])
    kd = np.array([joint.kd for joint in ROBOT.joints])
    return replace(Policy.of(ROBOT, arrays, kp, kd), **changes)
