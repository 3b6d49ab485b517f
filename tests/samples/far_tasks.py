"""What tests send to another process, which finds it by the name of this module."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import SimulationFault
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator


def draw_pd(rng: np.random.Generator) -> IdealPd:
    """Motors of an episode."""
    kp = rng.uniform(8.0, 10.0, 12)
    return IdealPd(kp, 0.095 * kp, np.full(12, 1.26), rng.uniform(0.002, 0.004, 12), rng.uniform(0.0, 0.01, 12))


def make_walker() -> WalkSimulator:
    """Walks of 60 control steps."""
    return WalkSimulator(Scene(PUPPER_V2, draw_pd, WalkConfig(episode_steps=60)))


class Counter:
    """A simulator that counts what it was asked."""

    def __init__(self) -> None:
        print("an engine's greeting")
        self.count = 0

    def close(self) -> None:
        """Nothing to give back."""


def count(simulator: Counter, shared: str, task: int) -> tuple[str, int, int, int]:
    """What it was asked, for the how manieth time, where."""
    simulator.count += 1
    return shared, task, simulator.count, os.getpid()


def fail(simulator: Any, shared: Any, task: int) -> None:
    """Break down."""
    raise SimulationFault("broken down " + "x" * 300, where="here", remedy="mend it " + "y" * 200)


def die(simulator: Any, shared: Any, task: int) -> None:
    """End the process."""
    os._exit(3)
