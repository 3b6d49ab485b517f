"""Weak, worn and damaged motors of virtual robots. The factors are assumptions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motorprior.actuator.physical import MotorParameters

WEAK, DAMAGED = 0.75, 0.4  # remaining torque of weak motors and of a damaged motor [-]
PLAY, FRICTION = 3.0, 1.5  # factors on backlash and friction of worn gears [-]
_STREAM = 0x3EA


def weak(motors: MotorParameters, number: int) -> MotorParameters:
    """A smaller torque constant, as with hot or aged magnets."""
    return _of_strength(motors, np.full(len(motors), WEAK))


def worn(motors: MotorParameters, number: int) -> MotorParameters:
    """Gears with more backlash and friction."""
    return motors.scaled({"backlash": PLAY, "coulomb": FRICTION, "load_friction": FRICTION})


def damaged(motors: MotorParameters, number: int) -> MotorParameters:
    """One random motor per robot with much less torque."""
    strength = np.ones(len(motors))
    strength[np.random.default_rng([_STREAM, number]).integers(len(motors))] = DAMAGED
    return _of_strength(motors, strength)


def _of_strength(motors: MotorParameters, strength: np.ndarray) -> MotorParameters:
    return motors.scaled(dict.fromkeys(("kp", "kd", "torque_limit", "stall_torque"), strength))


# functions of the motors of a virtual robot and its number
WEAR: dict[str, Callable[[MotorParameters, int], MotorParameters]] = {
    "none": lambda motors, number: motors, "weak": weak, "worn": worn, "damaged": damaged,
}  # fmt: skip
