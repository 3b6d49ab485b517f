"""What is measured of a walk in a study: `gait_quality`, and what depends on when it fell."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode
from motorprior.transfer.gait_quality import gait_quality, headings, way_along
from motorprior.transfer.study import share_upright

_OF_TORQUE = ("transport", "torque_beyond")


def walk_measures(robot: Robot, episode: Episode, forward: float, steps: int) -> dict[str, float]:
    """Measures of one walk straight ahead.

    speed is the way forward of the start over the whole time, also after a fall [m/s]; upright the share of the time
    before it; distance the way along the robot's own heading before it [m]; drift |way to the left| at the end [m], NaN
    after a fall, since who lies drifts no further; torque_beyond the share of joints and time at which a joint carries
    more than the torque limit of the robot's description. The rest is that of `gait_quality`. In an engine that tells
    no velocities they come from the differences of the poses, and what needs torques is NaN.

    Args:
        robot: that walked.
        episode: with its trace.
        forward: commanded speed [m/s].
        steps: of a walk without a fall.
    """
    told = len(episode.motion) == len(episode.trace)
    moved = episode if told else replace(episode, motion=_motion_of(robot, episode.trace))
    quality = asdict(gait_quality(robot, moved, forward, 0.0, steps))
    lifts = quality.pop("foot_lift_mm")
    shared = ("heading_deg_per_m", "lateral_share", "slip", "transport", "step_frequency", "body_rate")
    limit = np.array([joint.torque_limit for joint in robot.joints])
    torque = np.abs(moved.motion[:, 6 + robot.num_joints :])
    upright = share_upright(episode, steps)
    found = {
        "speed": float(episode.displacement[0]) / (steps * robot.control_dt),
        "upright": upright,
        "distance": way_along(episode.trace[:, :2], headings(episode.trace)),
        "drift": abs(float(episode.displacement[1])) if upright == 1.0 else float("nan"),
        **{name: float(quality[name]) for name in shared},
        "torque_beyond": float(np.mean(torque > limit)),
        "foot_lift_mm": float(np.mean(lifts)),
        **{f"foot_lift_mm/{leg.name}": float(lift) for leg, lift in zip(robot.legs, lifts, strict=True)},
    }
    return found if told else found | dict.fromkeys(_OF_TORQUE, float("nan"))


def _motion_of(robot: Robot, trace: np.ndarray) -> np.ndarray:
    """(steps, 6 + 2 joints) velocities as differences of a trace, and no torques.

    Angular velocity in the body's frame: 2·(conj(q)·dq/dt), its vector part.
    """
    motion = np.zeros((len(trace), 6 + 2 * robot.num_joints))
    if len(trace) < 2:
        return motion
    rate = np.gradient(trace, robot.control_dt, axis=0)
    motion[:, :3], motion[:, 6 : 6 + robot.num_joints] = rate[:, :3], rate[:, 7:]
    w, v = trace[:, 3:4], trace[:, 4:7]
    dw, dv = rate[:, 3:4], rate[:, 4:7]
    motion[:, 3:6] = 2.0 * (w * dv - v * dw - np.cross(v, dv))
    return motion
