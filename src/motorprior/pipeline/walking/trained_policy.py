"""What a training amounts to: whether its episodes were physics, and the policy that it found."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import Progress
from motorprior.robots.robot import Robot
from motorprior.search.policy_search import Champion


def judge_faults(curve: list[dict], episodes: int, progress: Progress) -> None:
    """Say which episodes of the training were no physics; each of them ended there, without reward.

    Args:
        curve: of the training, see `as_point`.
        episodes: of an iteration.
        progress: where to report to.

    Raises:
        SimulationFault: all of them.
    """
    faults, total = sum((Counter(point.get("faults", {})) for point in curve), Counter()), len(curve) * episodes
    for name, count in faults.items():
        progress.note(f"{count} of {total} episodes ended early: {name}")
    if faults.total() == total:
        raise SimulationFault(
            f"each of the {total} episodes broke down ({', '.join(faults)}): there is nothing to learn from",
            remedy="the motors are too stiff or too strong for the physics step: give smaller gains, or a softer gear",
        )


def policy_of(robot: Robot, gait: GaitName, champion: Champion, nominal: IdealPd, provenance: dict[str, Any]) -> Policy:
    """The champion as a policy.

    Args:
        robot: that it commands.
        gait: that it was trained in.
        champion: what training found.
        nominal: the gains that its motors run with.
        provenance: how it was trained.
    """
    arrays = champion.policy
    return Policy(
        weights=np.ascontiguousarray(arrays.weights),
        hidden=arrays.hidden,
        readout=arrays.readout,
        observation_mean=arrays.mean,
        observation_std=arrays.std,
        kp=nominal.kp,
        kd=nominal.kd,
        control_dt=robot.control_dt,
        robot=robot.name,
        joint_names=robot.joint_names,
        forward=robot.require_legs().forward,
        gait=gait,
        provenance=provenance | {"iteration": champion.iteration, "own_return": champion.score},
    )
