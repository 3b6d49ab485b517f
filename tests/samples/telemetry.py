"""Telemetry of a still robot."""

from typing import Any

import numpy as np

from motorprior.hardware.protocol import Telemetry

SCALARS = ("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate")


def telemetry(**values) -> Telemetry:
    """Telemetry with ``values``; the other fields are zero."""
    still: dict[str, Any] = dict.fromkeys(SCALARS, 0.0) | {"pos": np.zeros(12), "vel": np.zeros(12)}
    return Telemetry(**(still | values))
