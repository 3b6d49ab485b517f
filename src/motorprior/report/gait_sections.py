"""The chapters of the report about gaits: films, frames, which foot is on the ground when, and robustness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from motorprior.report.gait_picture import gait_animation, gait_strip
from motorprior.report.page import Picture, Section, picture
from motorprior.report.plots_gait import footfalls
from motorprior.report.plots_robustness import robustness_maps
from motorprior.report.plots_style import condition_color, model_label
from motorprior.robots.robot import Robot
from motorprior.simulation.foot_motion import foot_motion
from motorprior.simulation.skeleton import skeleton
from motorprior.transfer.gait_quality import CONTACT_HEIGHT
from motorprior.transfer.robustness import ROBUSTNESS_DRAWS, UprightMap

_SHORTEST_GAIT = 20
"""Control steps; a robot that fell before shows nothing."""
_SHOWN = 2.5
"""Time that a film lasts [s]."""
_CYCLES = 4.0
"""Cycles of the robot's usual frequency in a measured footfall pattern."""


def gait_pictures(
    robot: Robot, trace: np.ndarray, control_dt: float, name: str, place: str, animated: bool = True
) -> list[Picture]:
    """Animation and frames of the first 2.5 s of a walk, and its footfalls; none of one that falls at once.

    Args:
        robot: that walked.
        trace: (steps, 7 + joints) base position, quaternion and joint angles.
        control_dt: time between rows [s].
        name: of what it was trained on.
        place: where it walked.
        animated: with the animation, the largest of the three.
    """
    shown = trace[: round(_SHOWN / control_dt)]
    if len(shown) < _SHORTEST_GAIT:
        return []
    body, color = skeleton(robot, shown), condition_color(name)
    title = f"trained on {model_label(name)}, {place}"
    moving = [gait_animation(body, control_dt, title, color=color)] if animated else []
    films = [Picture(f"{title}: first 2.5 s.", title, film, "gif") for film in moving]
    strip = picture(gait_strip(body, control_dt, title, color=color), f"{title}: frames.", title)
    return [*films, strip, _footfall_picture(robot, trace, control_dt, title, color)]


def measured_stance(robot: Robot, trace: np.ndarray) -> np.ndarray:
    """(steps, legs) whether each foot's lowest point is on the ground, to half a millimetre."""
    at_rest = np.zeros((len(trace), 6 + robot.num_joints))
    return foot_motion(robot, trace, at_rest).clearance < CONTACT_HEIGHT


def _footfall_picture(robot: Robot, trace: np.ndarray, control_dt: float, title: str, color: str) -> Picture:
    """The last cycles of a walk."""
    last = trace[-round(_CYCLES / robot.require_legs().frequency / control_dt) :]
    legs, stance = [leg.name for leg in robot.legs], measured_stance(robot, last)
    figure = footfalls(
        {title: stance}, legs, len(last) * control_dt, "time, up to the end of the walk [s]", color=color
    )
    return picture(figure, f"{title}: which foot is on the ground when.", f"footfalls, {title}")


def gaits(robot: Robot, traces: Mapping[str, np.ndarray], control_dt: float) -> Section:
    """Policies in their own simulation.

    Args:
        robot: that walks.
        traces: name of the condition -> (steps, 7 + joints) base position, quaternion and joint angles.
        control_dt: time between rows [s].
    """
    pictures = [
        image
        for name, trace in traces.items()
        for image in gait_pictures(robot, trace, control_dt, name, "in its own simulation")
    ]
    return Section("Gaits", f"Robot {robot.name}, where each policy was trained.", pictures=tuple(pictures))


def robustness_section(maps: Mapping[str, Sequence[UprightMap]]) -> Section:
    """How far from the nominal robot each policy still walks.

    Args:
        maps: of each policy, by the name of what it was trained on.
    """
    pictures = tuple(
        picture(
            robustness_maps(each),
            f"trained on {model_label(name)}: share of {ROBUSTNESS_DRAWS} walks of 5 s before a fall.",
            f"robustness, trained on {model_label(name)}",
        )
        for name, each in maps.items()
    )
    lead = "Time upright, told to walk as fast as the policy may be told, where two things at a time are not as usual."
    body = ("Every cell has the same draws of the motors that the policy was trained on, in MuJoCo on flat ground.",)
    return Section("Robustness", lead, body, pictures)
