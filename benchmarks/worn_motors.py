"""Motors at the edge of a fleet: weak, worn or damaged ones of virtual robots. The factors are our assumption."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motorprior.actuator.physical import MotorParameters, scaled

WEAK, DAMAGED = 0.75, 0.4  # what is left of the torque of each motor, and of the one that is damaged [-]
PLAY, FRICTION = 3.0, 1.5  # of worn gears, over those of the same gears when new [-]
_STREAM = 0x3EA


def weak(motors: MotorParameters, number: int) -> MotorParameters:
    """All of less torque per ampere, as of hot or aged magnets."""
    return _of_strength(motors, np.full(len(motors), WEAK))


def worn(motors: MotorParameters, number: int) -> MotorParameters:
    """Gears with more play and friction."""
    return scaled(motors, {"backlash": PLAY, "coulomb": FRICTION, "load_friction": FRICTION})


def damaged(motors: MotorParameters, number: int) -> MotorParameters:
    """One motor of much less torque, drawn for every robot."""
    left = np.ones(len(motors))
    left[np.random.default_rng([_STREAM, number]).integers(len(motors))] = DAMAGED
    return _of_strength(motors, left)


def _of_strength(motors: MotorParameters, left: np.ndarray) -> MotorParameters:
    return scaled(motors, dict.fromkeys(("kp", "kd", "torque_limit", "stall_torque"), left))


WEAR: dict[str, Callable[[MotorParameters, int], MotorParameters]] = {
    "none": lambda motors, number: motors, "weak": weak, "worn": worn, "damaged": damaged,
}  # fmt: skip
"""By name; of the motors of a virtual robot and its number."""
