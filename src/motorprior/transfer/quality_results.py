"""The measures of a walk as rows of a table, with their units."""

from __future__ import annotations

import math
from dataclasses import fields

from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.transfer.gait_quality import GaitQuality

UNITS = {
    "upright": "1",
    "speed": "m/s",
    "speed_error": "1",
    "heading_deg_per_m": "°/m",
    "lateral_share": "1",
    "foot_lift_mm": "mm",
    "dragged_steps": "1",
    "slip": "m/m",
    "step_frequency": "Hz",
    "body_rate": "rad/s",
    "roll_deg": "°",
    "pitch_deg": "°",
    "torque": "N·m",
    "transport": "1",
}
"""Of every field of `GaitQuality`."""


def quality_results(quality: GaitQuality, robot: Robot, model: str, motors: str) -> Results:
    """One row per measure that is a number, the lift of every leg in a row of its own with the leg as its part.

    Args:
        quality: of a walk.
        robot: that walked.
        model: name of the policy.
        motors: own, twin or hard, see `results.Result`.
    """
    rows = []
    for field in fields(quality):
        value, legs = getattr(quality, field.name), (None,)
        if field.name == "foot_lift_mm":
            legs = tuple(leg.name for leg in robot.legs)
        for leg, number in zip(legs, value if len(legs) > 1 else (value,), strict=True):
            if math.isfinite(number):
                rows.append(Result(field.name, UNITS[field.name], float(number), model, motors, part=leg))
    return Results.of(rows)
