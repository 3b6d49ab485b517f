"""Motors on a motion that is imposed."""

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import reset_actuator, step_actuator


def torques(
    actuator: Actuator, inputs: np.ndarray, dt: float = 0.002, arrays: ActuatorArrays | None = None
):
    """(steps, n) torques [N·m] for (3, steps, n) targets, positions and velocities.

    The motors start at rest at the first target and position.
    """
    arrays = actuator.arrays(dt) if arrays is None else arrays
    out = np.zeros(inputs.shape[1:])
    reset_actuator(arrays, inputs[0, 0].copy(), inputs[1, 0].copy())
    for row, torque in zip(inputs.transpose(1, 0, 2).copy(), out, strict=True):
        step_actuator(arrays, dt, row[0], row[1], row[2], torque)
    return out
