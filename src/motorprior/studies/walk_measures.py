"""Measures of a walk in a study: `gait_quality`, and those that depend on the time of a fall."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode
from motorprior.studies.gait_quality import distance_along_heading, gait_quality, headings
from motorprior.studies.twin import share_upright

_FROM_QUALITY = ("heading_deg_per_m", "lateral_share", "slip", "transport", "step_frequency", "body_rate")
_NEED_TORQUES = ("transport", "torque_beyond")


def walk_measures(robot: Robot, episode: Episode, forward: float, steps: int) -> dict[str, float]:
    """Measures of one walk straight ahead.

    speed: forward displacement over the whole time, also after a fall [m/s]; upright: share of the time before a fall;
    distance: along the robot's heading before it [m]; drift: |final lateral displacement| [m], NaN after a fall;
    torque_beyond: share of joints and time with more than the described torque limit. Others: see `gait_quality`.
    If the engine gives no velocities, they are differences of the poses, and measures of torques are NaN.

    Args:
        robot: of the walk.
        episode: with its trace.
        forward: commanded speed [m/s].
        steps: control steps of a walk without a fall.
    """
    has_motion = len(episode.motion) == len(episode.trace)
    moved = episode if has_motion else replace(episode, motion=_motion_of(robot, episode.trace))
    quality = asdict(gait_quality(robot, moved, forward, 0.0, steps))
    lifts = quality.pop("foot_lift_mm")
    limit = np.array([joint.torque_limit for joint in robot.joints])
    torque = np.abs(moved.motion[:, 6 + robot.num_joints :])
    upright = share_upright(episode, steps)
    found = {
        "speed": float(episode.displacement[0]) / (steps * robot.control_dt),
        "upright": upright,
        "distance": distance_along_heading(episode.trace[:, :2], headings(episode.trace)),
        "drift": abs(float(episode.displacement[1])) if upright == 1.0 else float("nan"),
        **{name: float(quality[name]) for name in _FROM_QUALITY},
        "torque_beyond": float(np.mean(torque > limit)),
        "foot_lift_mm": float(np.mean(lifts)),
        **{f"foot_lift_mm/{leg.name}": float(lift) for leg, lift in zip(robot.legs, lifts, strict=True)},
    }
    return found if has_motion else found | dict.fromkeys(_NEED_TORQUES, float("nan"))


def _motion_of(robot: Robot, trace: np.ndarray) -> np.ndarray:
    """(steps, 6 + 2 joints) velocities as differences of a trace, and zero torques."""
    motion = np.zeros((len(trace), 6 + 2 * robot.num_joints))
    if len(trace) < 2:
        return motion
    rate = np.gradient(trace, robot.control_dt, axis=0)
    motion[:, :3], motion[:, 6 : 6 + robot.num_joints] = rate[:, :3], rate[:, 7:]
    # angular velocity in the body's frame: 2·(conj(q)·dq/dt), its vector part
    w, v = trace[:, 3:4], trace[:, 4:7]
    dw, dv = rate[:, 3:4], rate[:, 4:7]
    motion[:, 3:6] = 2.0 * (w * dv - v * dw - np.cross(v, dv))
    return motion
