"""How well a robot walks: what an owner sees, measured on the states of a walk in simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motorprior.locomotion.control_step import RAMP
from motorprior.robots.robot import Robot
from motorprior.rotations import roll_pitch_yaw
from motorprior.signals import rms
from motorprior.simulation.foot_motion import FootMotion, foot_motion
from motorprior.simulation.rollout import Episode

WARM_UP = 1.0
"""Time from standing to an even gait that no measure counts [s]."""
FALLING = 0.5
"""Time before a fall that no measure counts, since who tumbles does not walk [s]."""
TOUCHING = 0.0005
"""A foot whose lowest point is below this height [m] is on the ground."""
LIFTED = 4.0 * TOUCHING
"""A foot whose lowest point never gets above this height [m] in a step is dragged through it."""
LEAST_COMMAND = 0.1
"""Commanded speed below which nothing is told per metre or as a share of the command, of the robot's fastest [-]."""
_LEAST_STROKE = 0.02
"""What moves a foot by less along the body is no step, of the height at which the robot stands [-]."""
_LEAST_WAY = 0.05
"""Way below which nothing is told per metre [m]."""
_LEAST_TIME = 1.0
"""Of a walk, without its beginning and its fall; below it only upright is told [s]."""


@dataclass(frozen=True, eq=False)
class GaitQuality:
    """Measures of one walk, after its first second and, if it fell, before its last half second; NaN if not known.

    Where this leaves less than a second, a walk is upright or not, and no more is known of it, but that who fell in
    that time got nowhere. Of less than 5 cm of way nothing is told per metre, and nothing of a robot that is told less
    than a tenth of its fastest speed: it creeps.

    Attributes:
        upright: 1 if it did not fall, else 0.
        speed: way along the robot's own heading over time [m/s].
        speed_error: |speed - command| over |command| [-]; of a command of at least a tenth of the fastest.
        heading_deg_per_m: |heading - commanded heading| at the end over the way [°/m].
        lateral_share: sideways distance at the end from the way at its own speed along the commanded headings, which is
            a straight line without a turn, over the way [-].
        foot_lift_mm: (legs,) median over the swings of the highest clearance of a foot [mm]; a swing of no more than
            2 mm is none.
        dragged_steps: share of a foot's steps in which its lowest point stays within 2 mm of the ground, mean of the
            feet that make steps [-]. A step is what a foot does until it passes, once more and in the same direction,
            the middle of its stroke along the body, so that one that never leaves the ground makes steps, too.
        slip: way that a foot's lowest point slides on the ground, within 0.5 mm of it, mean of the feet, over the way
            [m/m].
        step_frequency: swings per leg and second [Hz].
        body_rate: RMS of the rates about the body's x and y axes: how much it shakes [rad/s].
        roll_deg: RMS [°].
        pitch_deg: RMS [°].
        torque: 99.9th percentile of |torque| over the joints and time, that of the joints' largest [N·m].
        transport: cost of transport, Σ |torque · joint velocity| over weight and speed [-].
    """

    upright: float
    speed: float
    speed_error: float
    heading_deg_per_m: float
    lateral_share: float
    foot_lift_mm: np.ndarray
    dragged_steps: float
    slip: float
    step_frequency: float
    body_rate: float
    roll_deg: float
    pitch_deg: float
    torque: float
    transport: float


def lasted(episode: Episode, steps: int) -> bool:
    """Whether an episode went on for so many control steps, without a fall or a breakdown of the physics."""
    return episode.steps >= steps and episode.fault == 0


def gait_quality(robot: Robot, episode: Episode, forward: float, yaw_rate: float, steps: int) -> GaitQuality:
    """Measure an episode with one command.

    Args:
        robot: that walked.
        episode: with trace and motion.
        forward: commanded speed [m/s].
        yaw_rate: commanded yaw rate [rad/s].
        steps: of an episode without a fall.
    """
    dt, begin = robot.control_dt, round(WARM_UP / robot.control_dt)
    upright = float(lasted(episode, steps))
    end = len(episode.trace) - (0 if upright else round(FALLING / dt))
    walks = abs(forward) >= LEAST_COMMAND * robot.require_legs().forward[1]
    if end < begin + round(_LEAST_TIME / dt):
        return _of_a_short_walk(upright, len(robot.legs), walks)
    heading = headings(episode.trace[:end])
    goal = heading[0] + _commanded_heading(robot, yaw_rate, len(heading))
    qpos, moved = episode.trace[begin:end], episode.motion[begin:end]
    qvel, torque = moved[:, : 6 + robot.num_joints], moved[:, 6 + robot.num_joints :]
    roll, pitch, _ = np.array([roll_pitch_yaw(quat) for quat in qpos[:, 3:7]]).T
    yaw, time = heading[begin:], dt * (len(qpos) - 1)
    along = way_along(qpos[:, :2], yaw)
    speed = along / time
    way, pace = (abs(along), abs(speed)) if walks and abs(along) >= _LEAST_WAY else (math.nan, math.nan)
    feet = foot_motion(robot, qpos, qvel)
    swings = _swings(feet)
    power = float(np.mean(np.abs(torque * qvel[:, 6:]).sum(axis=1)))
    return GaitQuality(
        upright=upright,
        speed=speed,
        speed_error=abs(speed - forward) / abs(forward) if walks else math.nan,
        heading_deg_per_m=math.degrees(abs(float(heading[-1] - goal[-1]))) / way,
        lateral_share=abs(_aside(qpos[:, :2], goal[begin:], speed * dt)) / way,
        foot_lift_mm=np.array([1e3 * float(np.median(lifts or [0.0])) for lifts in swings]),
        dragged_steps=_dragged(feet, _LEAST_STROKE * robot.standing_height),
        slip=float(np.mean(np.sum(feet.sliding * (feet.clearance < TOUCHING), axis=0))) * dt / way,
        step_frequency=float(np.mean([len(lifts) for lifts in swings])) / time,
        body_rate=float(np.sqrt(np.mean(np.square(qvel[:, 3:5]).sum(axis=1)))),
        roll_deg=math.degrees(float(rms(roll))),
        pitch_deg=math.degrees(float(rms(pitch))),
        torque=float(np.percentile(np.abs(torque).max(axis=1), 99.9)),
        transport=power / (robot.weight * pace),
    )


def headings(qpos: np.ndarray) -> np.ndarray:
    """(F,) headings [rad] of poses (F, 7 + joints), without jumps of whole turns."""
    return np.unwrap([roll_pitch_yaw(quat)[2] for quat in qpos[:, 3:7]])


def way_along(place: np.ndarray, yaw: np.ndarray) -> float:
    """Way of the base along its own heading [m], from (F, 2) places [m] and (F,) headings [rad]."""
    return float(np.sum(steps_along(place, yaw)))


def steps_along(place: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """(F - 1,) parts of `way_along` [m], backward below 0."""
    step = np.diff(place, axis=0)
    return np.cos(yaw[:-1]) * step[:, 0] + np.sin(yaw[:-1]) * step[:, 1]


def _commanded_heading(robot: Robot, yaw_rate: float, steps: int) -> np.ndarray:
    """(steps,) heading [rad] before every control step that a command leads to, 0 before the first.

    The command comes into force over a while, see `follow_command`.
    """
    reached = robot.require_legs().yaw_rate * robot.control_dt / RAMP * np.arange(steps)
    rates = np.sign(yaw_rate) * np.minimum(abs(yaw_rate), reached)  # of the control step before
    return robot.control_dt * np.cumsum(rates)


def _aside(place: np.ndarray, goal: np.ndarray, step: float) -> float:
    """Distance of the end, to the left, from the way of the commanded headings [m].

    Args:
        place: (F, 2) of the base [m].
        goal: (F,) commanded headings [rad].
        step: way in a control step [m], the walk's own.
    """
    off = place[-1] - place[0] - step * np.array([np.cos(goal[:-1]).sum(), np.sin(goal[:-1]).sum()])
    return float(math.cos(goal[-1]) * off[1] - math.sin(goal[-1]) * off[0])


def _swings(feet: FootMotion) -> list[list[float]]:
    """By leg the highest clearance of every whole swing [m]; a foot that barely leaves the ground does not swing."""
    lifts = []
    for clearance in feet.clearance.T:
        edges = np.flatnonzero(np.diff((clearance >= TOUCHING).astype(int)))
        parts = [part for part in np.split(clearance, edges + 1)[1:-1] if part[0] >= TOUCHING]
        lifts.append([float(part.max()) for part in parts if part.max() > LIFTED])
    return lifts


def _dragged(feet: FootMotion, least: float) -> float:
    """Mean over the feet of the share of their steps without a lift; NaN where none moves by ``least`` [m]."""
    peaks = [_step_peaks(*each, least) for each in zip(feet.clearance.T, feet.ahead.T, strict=True)]
    shares = [float(np.mean(each <= LIFTED)) for each in peaks if len(each)]
    return float(np.mean(shares)) if shares else math.nan


def _step_peaks(clearance: np.ndarray, ahead: np.ndarray, least: float) -> np.ndarray:
    """Highest clearance [m] in every whole step of a foot.

    A step is counted by the foot's stroke, not by its lift: a foot that touches twice in a swing makes one step, and so
    does one that never leaves the ground. It passes the middle when it is a quarter of the stroke beyond.

    Args:
        clearance: (F,) [m].
        ahead: (F,) place along the body [m].
        least: stroke below which there is no step [m].
    """
    rear, front = np.percentile(ahead, (5.0, 95.0))
    if front - rear <= least:
        return np.zeros(0)
    off = (ahead - 0.5 * (front + rear)) / (front - rear)
    beyond = np.flatnonzero(np.abs(off) > 0.25)
    passes = 1 + np.flatnonzero(np.diff(np.sign(off[beyond])))
    both = [beyond[passes[first::2]] for first in (0, 1)]  # forward, and backward
    edges = min(both, key=lambda each: clearance[each].mean() if len(each) else math.inf)  # where the foot stands
    return np.array([clearance[begin:end].max() for begin, end in pairwise(edges)])


def _of_a_short_walk(upright: float, legs: int, walks: bool) -> GaitQuality:
    """Who fell at once got nowhere; of who is upright yet, nothing is known."""
    speed, error = (math.nan, math.nan) if upright else (0.0, 1.0 if walks else math.nan)
    return GaitQuality(upright, speed, error, math.nan, math.nan, np.full(legs, math.nan), *8 * [math.nan])
