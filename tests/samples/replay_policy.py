"""A policy on random measurements, in this process or without numba in another."""

import json  # noqa: F401  # for the other process

import numpy as np

from motorprior.hardware.health import Measurement
from motorprior.hardware.motions import PolicyMotion
from motorprior.hardware.protocol import Telemetry
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2

BODY = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


def replay(path) -> list[list[float]]:
    """(steps, joints) targets [rad] of the policy at ``path``."""
    rng = np.random.default_rng(0)
    motion = PolicyMotion(PUPPER_V2, Policy.load(path))
    targets = []
    motion.forward = 0.4
    for step in range(300):
        motion.yaw_rate = 0.5 * np.sin(0.1 * step)
        body = dict(zip(BODY, rng.normal(0.0, 0.5, 6).tolist(), strict=True))
        pos = PUPPER_V2.nominal_pose + rng.normal(0.0, 0.5, 12)
        frame = Telemetry(ts=10.0 * step, **body, pos=pos, vel=np.zeros(12))
        targets.append(motion(Measurement(frame, 0.0, 0.0)).tolist())
    return targets
