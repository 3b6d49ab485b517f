"""Results of a training: check that its episodes were valid, and make the policy."""

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
from motorprior.search.policy_search import BestPolicy


def report_faults(curve: list[dict], episodes: int, progress: Progress) -> None:
    """Note the simulation faults of a training; each ended its episode without reward.

    Args:
        curve: of the training, see `training.as_point`.
        episodes: per iteration.
        progress: receives the notes.

    Raises:
        SimulationFault: every episode had one.
    """
    faults, total = sum((Counter(point.get("faults", {})) for point in curve), Counter()), len(curve) * episodes
    for name, count in faults.items():
        progress.note(f"{count} of {total} episodes ended early: {name}")
    if faults.total() == total:
        raise SimulationFault(
            f"each of the {total} episodes had a simulation fault ({', '.join(faults)})",
            remedy="the motors are too stiff or too strong for the physics step: use smaller gains or softer motors",
        )


def policy_of(robot: Robot, gait: GaitName, champion: BestPolicy, nominal: IdealPd, provenance: dict[str, Any]) -> Policy:
    """The best policy of a training.

    Args:
        robot: with the range of speeds that it was trained for.
        gait: that it was trained in.
        champion: the result of the search.
        nominal: PD gains of the robot's motors.
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
