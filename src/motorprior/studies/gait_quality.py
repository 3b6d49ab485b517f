"""Measures of one walk, computed from simulated states."""

import math
from collections.abc import Mapping

import numpy as np

from motorprior.locomotion.control_step import RAMP
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.rotations import roll_pitch_yaw
from motorprior.simulation.rendering import foot_motion
from motorprior.simulation.scene import Episode

WARM_UP = 1.0  # time from standing to a steady gait, which is not measured [s]
FALL_TIME = 0.5  # time before a fall, which is not measured [s]
CONTACT_HEIGHT = 0.0005  # a foot whose lowest point is below this height is on the ground [m]
LIFTED = 4.0 * CONTACT_HEIGHT  # a swing whose maximum clearance is below it does not count [m]
# share of the maximum speed below which metrics relative to speed or distance are NaN
MIN_COMMAND = 0.1
_MIN_DISTANCE = 0.05  # distance below which metrics per metre are NaN [m]
_MIN_TIME = 1.0  # minimum duration of the measured part of a walk [s]

# units of the metrics of `gait_quality` and `walk_metrics`; foot_lift_mm/LEG is per leg
UNITS = {
    "upright": "1",
    "speed": "m/s",
    "speed_error": "1",
    "heading_deg_per_m": "°/m",
    "lateral_share": "1",
    "foot_lift_mm": "mm",
    "step_frequency": "Hz",
    "slip": "m/m",
    "body_rate": "rad/s",
    "cost_of_transport": "1",
    "drift": "m",
}
# metrics of `gait_quality` that a study has, too
_OF_STUDY = (
    "heading_deg_per_m",
    "lateral_share",
    "slip",
    "cost_of_transport",
    "body_rate",
    "step_frequency",
)


def completed(episode: Episode, steps: int) -> bool:
    """Whether an episode lasted ``steps`` control steps, without a fall or a simulation fault."""
    return episode.steps >= steps and episode.fault == 0


def share_upright(episode: Episode, steps: int) -> float:
    """Share of ``steps`` control steps before a fall or a simulation fault [-]."""
    return (episode.steps - (not completed(episode, steps))) / steps


def gait_quality(
    robot: Robot, episode: Episode, forward: float, yaw_rate: float, steps: int
) -> dict[str, float]:
    """Measures of a walk with a constant command.

    The walk is measured after its first second and, if it fell, before the last half second. If
    less than a second remains, there is only ``upright``, and a speed of 0 after a fall. Undefined
    metrics are NaN. Without velocities from the engine, differences of the poses are used, and
    metrics of torques are NaN. Metrics per metre need 5 cm of distance and a command of at least
    a tenth of the robot's maximum speed.

    upright: 1 without a fall, else 0; speed: distance along the robot's own heading over time
    [m/s]; speed_error: |speed - command| / |command|; heading_deg_per_m: final |heading - commanded
    heading| over the distance [°/m]; lateral_share: final lateral distance from the commanded path
    at the walk's own speed, over the distance; foot_lift_mm/LEG: median over the swings of the
    maximum clearance of the foot [mm], of swings above 2 mm; step_frequency: number of these swings
    per leg over the time [Hz]; slip: distance that a foot's lowest
    point slides within 0.5 mm of the ground, mean over the feet, over the distance [m/m];
    body_rate: RMS of the angular rate about the body's x and y axes [rad/s]; cost_of_transport:
    mean of Σ |torque · joint velocity| over weight · |speed|.

    ``forward`` [m/s] and ``yaw_rate`` [rad/s] are commanded; an episode without a fall has
    ``steps`` control steps.
    """
    dt = robot.control_dt
    begin = round(WARM_UP / dt)
    end = len(episode.trace)
    is_upright = completed(episode, steps)
    if not is_upright:
        end -= round(FALL_TIME / dt)
    is_commanded = abs(forward) >= MIN_COMMAND * robot.require_gait().forward[1]

    if end < begin + round(_MIN_TIME / dt):
        if is_upright:
            return {"upright": 1.0}
        return {"upright": 0.0, "speed": 0.0, "speed_error": 1.0 if is_commanded else math.nan}

    # the measured part of the walk
    motion = episode.motion if len(episode.motion) else _motion_of(robot, episode.trace)
    qpos = episode.trace[begin:end]
    qvel = motion[begin:end, : 6 + robot.num_joints]
    torque = motion[begin:end, 6 + robot.num_joints :]

    # speed and distance
    heading = headings(episode.trace[:end])
    goal = heading[0] + _commanded_heading(robot, yaw_rate, len(heading))
    along = float(np.sum(steps_along_heading(qpos[:, :2], heading[begin:])))
    speed = along / (dt * (len(qpos) - 1))
    distance = math.nan
    pace = math.nan
    if is_commanded and abs(along) >= _MIN_DISTANCE:
        distance = abs(along)
        pace = abs(speed)

    metrics = {"upright": float(is_upright), "speed": speed, "speed_error": math.nan}
    if is_commanded:
        metrics["speed_error"] = abs(speed - forward) / abs(forward)
    heading_error = math.degrees(abs(float(heading[-1] - goal[-1])))
    metrics["heading_deg_per_m"] = heading_error / distance
    lateral = _lateral_distance(qpos[:, :2], goal[begin:], speed * dt)
    metrics["lateral_share"] = abs(lateral) / distance

    clearance, sliding = foot_motion(robot, qpos, qvel)
    num_swings = 0
    for leg, clearance_of_leg in zip(robot.legs, clearance.T, strict=True):
        lifts = _lifts(clearance_of_leg)
        num_swings += len(lifts)
        metrics[f"foot_lift_mm/{leg.name}"] = 1e3 * float(np.median(lifts or [0.0]))
    metrics["step_frequency"] = num_swings / (len(robot.legs) * dt * len(qpos))
    sliding_on_ground = np.sum(sliding * (clearance < CONTACT_HEIGHT), axis=0)
    metrics["slip"] = float(np.mean(sliding_on_ground)) * dt / distance

    tumbling = np.square(qvel[:, 3:5]).sum(axis=1)
    metrics["body_rate"] = float(np.sqrt(np.mean(tumbling)))
    power = float(np.mean(np.abs(torque * qvel[:, 6:]).sum(axis=1)))
    metrics["cost_of_transport"] = power / (robot.weight * pace)
    return metrics


def walk_metrics(robot: Robot, episode: Episode, forward: float, steps: int) -> dict[str, float]:
    """Measures of one walk straight ahead in a study, also of a short one.

    speed: forward displacement over the whole time, also after a fall [m/s]; upright: share of the
    time before a fall; drift: |final lateral displacement| [m], NaN after a fall; foot_lift_mm:
    mean over the legs. For the others, and the arguments, see `gait_quality`. All metrics are NaN
    if the simulation diverged, which is no fall.
    """
    if episode.fault:
        return dict.fromkeys(("speed", "upright", "drift", *_OF_STUDY, "foot_lift_mm"), math.nan)

    upright = share_upright(episode, steps)
    displacement = episode.displacement
    metrics = {
        "speed": float(displacement[0]) / (steps * robot.control_dt),
        "upright": upright,
        "drift": abs(float(displacement[1])) if upright == 1.0 else math.nan,
    }
    quality = gait_quality(robot, episode, forward, 0.0, steps)
    for name in _OF_STUDY:
        metrics[name] = quality.get(name, math.nan)
    lifts = [quality.get(f"foot_lift_mm/{leg.name}", math.nan) for leg in robot.legs]
    metrics["foot_lift_mm"] = float(np.mean(lifts))
    return metrics


def _motion_of(robot: Robot, trace: np.ndarray) -> np.ndarray:
    """(steps, 6 + 2 joints) velocities as differences of a trace, and NaN for the torques."""
    motion = np.full((len(trace), 6 + 2 * robot.num_joints), np.nan)
    rate = np.gradient(trace, robot.control_dt, axis=0)
    motion[:, :3] = rate[:, :3]
    motion[:, 6 : 6 + robot.num_joints] = rate[:, 7:]

    # angular velocity in the body's frame: the vector part of 2·conj(q)·dq/dt
    w = trace[:, 3:4]
    v = trace[:, 4:7]
    dw = rate[:, 3:4]
    dv = rate[:, 4:7]
    motion[:, 3:6] = 2.0 * (w * dv - v * dw - np.cross(v, dv))
    return motion


def headings(qpos: np.ndarray) -> np.ndarray:
    """(F,) headings [rad] of poses (F, 7 + joints), unwrapped."""
    return np.unwrap([roll_pitch_yaw(quat)[2] for quat in qpos[:, 3:7]])


def steps_along_heading(position: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """(F - 1,) distances along the heading [m], backward below 0.

    Arguments are positions (F, 2) [m] and headings (F,) [rad].
    """
    step = np.diff(position, axis=0)
    return np.cos(yaw[:-1]) * step[:, 0] + np.sin(yaw[:-1]) * step[:, 1]


def _commanded_heading(robot: Robot, yaw_rate: float, steps: int) -> np.ndarray:
    """(steps,) commanded heading [rad] before every control step, with the ramp of a command.

    It is 0 before the first step.
    """
    reached = robot.require_gait().yaw_rate * robot.control_dt / RAMP * np.arange(steps)
    rates = np.sign(yaw_rate) * np.minimum(abs(yaw_rate), reached)  # of the previous control step
    return robot.control_dt * np.cumsum(rates)


def _lateral_distance(position: np.ndarray, goal: np.ndarray, step: float) -> float:
    """Final distance [m] to the left of a path.

    The path has steps of length ``step`` [m] along the commanded headings ``goal`` (F,) [rad].
    """
    path = step * np.array([np.cos(goal[:-1]).sum(), np.sin(goal[:-1]).sum()])
    off = position[-1] - position[0] - path
    return float(math.cos(goal[-1]) * off[1] - math.sin(goal[-1]) * off[0])


def _lifts(clearance: np.ndarray) -> list[float]:
    """Maximum clearance [m] of every complete swing.

    ``clearance`` (F,) is the height of a foot above the ground [m]. Swings below LIFTED do
    not count.
    """
    is_lifted = clearance >= CONTACT_HEIGHT
    edges = np.flatnonzero(np.diff(is_lifted.astype(int)))
    heights = []
    for phase in np.split(clearance, edges + 1)[1:-1]:
        is_swing = phase[0] >= CONTACT_HEIGHT
        if is_swing and phase.max() > LIFTED:
            heights.append(float(phase.max()))
    return heights


def quality_results(quality: Mapping[str, float], model: str, motors: str) -> Results:
    """A row per finite metric of a policy ``model``; the lift has a row per leg.

    ``motors`` are own, twin or hard.
    """
    rows = []
    for metric, value in quality.items():
        name, _, leg = metric.partition("/")
        if math.isfinite(value):
            rows.append(Result(name, UNITS[name], value, model, motors, part=leg or None))
    return Results(rows)
