"""Gait quality: measures of one walk, computed from simulated states."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motorprior.locomotion.control_step import RAMP
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.rotations import roll_pitch_yaw
from motorprior.signals import rms
from motorprior.simulation.foot_motion import FootMotion, foot_motion
from motorprior.simulation.rollout import Episode

WARM_UP = 1.0  # [s] from standing to a steady gait, not measured
FALL_TIME = 0.5  # [s] before a fall, not measured
CONTACT_HEIGHT = 0.0005  # [m] a foot whose lowest point is below is on the ground
LIFTED = 4.0 * CONTACT_HEIGHT  # [m] a foot that stays below in a step is dragged
MIN_COMMAND = 0.1  # of the robot's maximum speed; below it measures relative to speed or distance are NaN
_MIN_STROKE = 0.02  # of the standing height; a foot that moves less along the body makes no step
_MIN_DISTANCE = 0.05  # [m] below which measures per metre are NaN
_MIN_TIME = 1.0  # [s] of a walk, without its start and its fall

UNITS = {  # of the fields of `GaitQuality`
    "upright": "1", "speed": "m/s", "speed_error": "1", "heading_deg_per_m": "°/m", "lateral_share": "1",
    "foot_lift_mm": "mm", "dragged_steps": "1", "slip": "m/m", "step_frequency": "Hz", "body_rate": "rad/s",
    "roll_deg": "°", "pitch_deg": "°", "torque": "N·m", "transport": "1",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class GaitQuality:
    """Measures of one walk after its first second and, if it fell, before the last half second; NaN if undefined.

    If less than a second is left, only ``upright`` is defined, and a speed of 0 if it fell. Measures per metre need
    5 cm of distance and a command of at least a tenth of the robot's maximum speed.

    Attributes:
        upright: 1 without a fall, else 0.
        speed: distance along the robot's own heading over time [m/s].
        speed_error: |speed - command| / |command| [-].
        heading_deg_per_m: final |heading - commanded heading| over the distance [°/m].
        lateral_share: final lateral distance from the commanded path at the walk's own speed, over the distance [-].
        foot_lift_mm: (legs,) median over the swings of the maximum clearance of a foot [mm]; swings are above 2 mm.
        dragged_steps: share of a foot's steps in which its lowest point stays within 2 mm of the ground, mean over the
            feet that make steps [-]. A step lasts until the foot passes the middle of its stroke along the body again
            in the same direction; it does not need a lift.
        slip: distance that a foot's lowest point slides within 0.5 mm of the ground, mean over the feet, over the
            distance [m/m].
        step_frequency: swings per leg and second [Hz].
        body_rate: RMS of the angular rate about the body's x and y axes [rad/s].
        roll_deg: RMS [°].
        pitch_deg: RMS [°].
        torque: 99.9th percentile over time of the maximum |torque| over the joints [N·m].
        transport: cost of transport, mean of Σ |torque · joint velocity| over weight · |speed| [-].
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


def completed(episode: Episode, steps: int) -> bool:
    """Whether an episode lasted ``steps`` control steps, without a fall or a simulation fault."""
    return episode.steps >= steps and episode.fault == 0


def gait_quality(robot: Robot, episode: Episode, forward: float, yaw_rate: float, steps: int) -> GaitQuality:
    """Measure an episode with a constant command.

    Args:
        robot: of the episode.
        episode: with trace and motion.
        forward: commanded speed [m/s].
        yaw_rate: commanded yaw rate [rad/s].
        steps: control steps of an episode without a fall.
    """
    dt, begin = robot.control_dt, round(WARM_UP / robot.control_dt)
    upright = float(completed(episode, steps))
    end = len(episode.trace) - (0 if upright else round(FALL_TIME / dt))
    walks = abs(forward) >= MIN_COMMAND * robot.require_legs().forward[1]
    if end < begin + round(_MIN_TIME / dt):
        return _short_walk(upright, len(robot.legs), walks)
    heading = headings(episode.trace[:end])
    goal = heading[0] + _commanded_heading(robot, yaw_rate, len(heading))
    qpos, moved = episode.trace[begin:end], episode.motion[begin:end]
    qvel, torque = moved[:, : 6 + robot.num_joints], moved[:, 6 + robot.num_joints :]
    roll, pitch, _ = np.array([roll_pitch_yaw(quat) for quat in qpos[:, 3:7]]).T
    yaw, time = heading[begin:], dt * (len(qpos) - 1)
    along = distance_along_heading(qpos[:, :2], yaw)
    speed = along / time
    defined = walks and abs(along) >= _MIN_DISTANCE
    distance, pace = (abs(along), abs(speed)) if defined else (math.nan, math.nan)
    feet = foot_motion(robot, qpos, qvel)
    swings = _swings(feet)
    power = float(np.mean(np.abs(torque * qvel[:, 6:]).sum(axis=1)))
    return GaitQuality(
        upright=upright,
        speed=speed,
        speed_error=abs(speed - forward) / abs(forward) if walks else math.nan,
        heading_deg_per_m=math.degrees(abs(float(heading[-1] - goal[-1]))) / distance,
        lateral_share=abs(_lateral_distance(qpos[:, :2], goal[begin:], speed * dt)) / distance,
        foot_lift_mm=np.array([1e3 * float(np.median(lifts or [0.0])) for lifts in swings]),
        dragged_steps=_dragged(feet, _MIN_STROKE * robot.standing_height),
        slip=float(np.mean(np.sum(feet.sliding * (feet.clearance < CONTACT_HEIGHT), axis=0))) * dt / distance,
        step_frequency=float(np.mean([len(lifts) for lifts in swings])) / time,
        body_rate=float(np.sqrt(np.mean(np.square(qvel[:, 3:5]).sum(axis=1)))),
        roll_deg=math.degrees(float(rms(roll))),
        pitch_deg=math.degrees(float(rms(pitch))),
        torque=float(np.percentile(np.abs(torque).max(axis=1), 99.9)),
        transport=power / (robot.weight * pace),
    )


def headings(qpos: np.ndarray) -> np.ndarray:
    """(F,) headings [rad] of poses (F, 7 + joints), unwrapped."""
    return np.unwrap([roll_pitch_yaw(quat)[2] for quat in qpos[:, 3:7]])


def distance_along_heading(position: np.ndarray, yaw: np.ndarray) -> float:
    """Distance of the base along its own heading [m], from (F, 2) positions [m] and (F,) headings [rad]."""
    return float(np.sum(steps_along_heading(position, yaw)))


def steps_along_heading(position: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """(F - 1,) summands of `distance_along_heading` [m], backward below 0."""
    step = np.diff(position, axis=0)
    return np.cos(yaw[:-1]) * step[:, 0] + np.sin(yaw[:-1]) * step[:, 1]


def _commanded_heading(robot: Robot, yaw_rate: float, steps: int) -> np.ndarray:
    """(steps,) commanded heading [rad] before every control step, 0 before the first, with the ramp of a command."""
    reached = robot.require_legs().yaw_rate * robot.control_dt / RAMP * np.arange(steps)
    rates = np.sign(yaw_rate) * np.minimum(abs(yaw_rate), reached)  # of the previous control step
    return robot.control_dt * np.cumsum(rates)


def _lateral_distance(position: np.ndarray, goal: np.ndarray, step: float) -> float:
    """Final distance to the left [m] of the path with commanded headings ``goal`` (F,) [rad] and ``step`` [m]."""
    off = position[-1] - position[0] - step * np.array([np.cos(goal[:-1]).sum(), np.sin(goal[:-1]).sum()])
    return float(math.cos(goal[-1]) * off[1] - math.sin(goal[-1]) * off[0])


def _swings(feet: FootMotion) -> list[list[float]]:
    """Per leg the maximum clearance of every complete swing above LIFTED [m]."""
    lifts = []
    for clearance in feet.clearance.T:
        edges = np.flatnonzero(np.diff((clearance >= CONTACT_HEIGHT).astype(int)))
        swings = [each for each in np.split(clearance, edges + 1)[1:-1] if each[0] >= CONTACT_HEIGHT]
        lifts.append([float(each.max()) for each in swings if each.max() > LIFTED])
    return lifts


def _dragged(feet: FootMotion, min_stroke: float) -> float:
    """Mean over the feet of their share of steps without a lift; NaN if no foot moves by ``min_stroke`` [m]."""
    peaks = [_step_peaks(*each, min_stroke) for each in zip(feet.clearance.T, feet.ahead.T, strict=True)]
    shares = [float(np.mean(each <= LIFTED)) for each in peaks if len(each)]
    return float(np.mean(shares)) if shares else math.nan


def _step_peaks(clearance: np.ndarray, ahead: np.ndarray, min_stroke: float) -> np.ndarray:
    """Maximum clearance [m] in every complete step of a foot, from its clearance and position along the body (F,) [m].

    Steps are counted by stroke, not by lift. A foot passes the middle once it is a quarter of the stroke beyond.
    """
    rear, front = np.percentile(ahead, (5.0, 95.0))
    if front - rear <= min_stroke:
        return np.zeros(0)
    off = (ahead - 0.5 * (front + rear)) / (front - rear)
    beyond = np.flatnonzero(np.abs(off) > 0.25)
    passes = 1 + np.flatnonzero(np.diff(np.sign(off[beyond])))
    both = [beyond[passes[first::2]] for first in (0, 1)]  # forward, and backward
    edges = min(both, key=lambda each: clearance[each].mean() if len(each) else math.inf)  # cut during stance
    return np.array([clearance[begin:end].max() for begin, end in pairwise(edges)])


def _short_walk(upright: float, legs: int, walks: bool) -> GaitQuality:
    speed, error = (math.nan, math.nan) if upright else (0.0, 1.0 if walks else math.nan)
    return GaitQuality(upright, speed, error, math.nan, math.nan, np.full(legs, math.nan), *8 * [math.nan])


def quality_results(quality: GaitQuality, robot: Robot, model: str, motors: str) -> Results:
    """A row per finite measure of a policy ``model``, for the lift a row per leg; ``motors``: own, twin or hard."""
    rows = []
    for name, unit in UNITS.items():
        value = getattr(quality, name)
        parts = zip((leg.name for leg in robot.legs), value, strict=True) if name == "foot_lift_mm" else [(None, value)]
        rows += [
            Result(name, unit, float(number), model, motors, part=leg) for leg, number in parts if math.isfinite(number)
        ]
    return Results.of(rows)
