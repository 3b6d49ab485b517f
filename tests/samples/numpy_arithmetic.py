"""The step of a geared motor in numpy."""

import numpy as np

from motorprior.actuator.geared_motor_step import Arithmetic

NUMPY = Arithmetic(
    where=np.where,
    indicator=lambda condition: 1.0 * condition,
    clip=lambda x, limit: np.clip(x, -limit, limit),
    positive_part=lambda x: np.maximum(x, 0.0),
    with_sign_of=lambda magnitude, other: np.sign(other) * magnitude,
    sqrt=np.sqrt,
)
