"""The untrained gait as a policy."""

from __future__ import annotations

import numpy as np

from motorprior.locomotion.ars import RunningStats
from motorprior.locomotion.policy import PolicyArrays
from motorprior.locomotion.policy_shape import PolicyShape


def zero_policy(num_joints: int) -> PolicyArrays:
    """The policy of zero actions, which is the untrained gait."""
    shape = PolicyShape(num_joints)
    return shape.policy(np.zeros(shape.size), RunningStats.empty(shape.observations))
