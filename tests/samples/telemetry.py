"""Telemetry of a still robot."""

import numpy as np

from motorprior.hardware.protocol import Telemetry


def telemetry(**values) -> Telemetry:
    """Zeros, but for ``values``."""
    zeros = dict.fromkeys(
        ("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0
    )
    return Telemetry(**{**zeros, "pos": np.zeros(12), "vel": np.zeros(12), **values})
